"""What the kernels of the contract's program and of the examples take on NVIDIA's GPUs; nothing of them is spilled.

Where LLVM and ``ptxas`` are other versions than those that the table names, registers and spills are not compared.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from test_ir import program

import ptx
from backends import HAS_WHEELS
from example_runs import EXAMPLES

TABLE = Path(__file__).parent / "ptx.txt"

pytestmark = pytest.mark.skipif(ptx.ptxas() is None and not HAS_WHEELS, reason="there is no ptxas")


def run_program() -> None:
    for kernel, relation in program().values():
        kernel(relation)


def run_example(name: str) -> None:
    EXAMPLES[name]()[0](0)


RUNS: dict[str, Callable[[], None]] = {
    "the contract's program": run_program,
    **{f"examples/{name}.py": lambda name=name: run_example(name) for name in EXAMPLES},
}


def test_what_kernels_take_on_gpus(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, golden) -> None:
    lines = ptx.header()
    for title, run in RUNS.items():
        with ptx.emitting(monkeypatch) as made:
            run()
        lines += ["", title, *ptx.rows_of(made.images)]
        for capability, text in made.images:
            assert not any(entry.spilled for entry in ptx.assembled(text, capability).values())
    table = "\n".join(lines) + "\n"
    if request.config.getoption("--update-golden"):
        golden(TABLE, table)
    recorded, found = ptx.compared(TABLE.read_text(encoding="utf-8"), table)
    assert found == recorded
