"""What the kernels of the contract's program and of the examples take on NVIDIA's GPUs; nothing of them is spilled.

Those of the conformance programs have tables too (``tests/conformance/ptx``), compared in the long run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from test_ir import program

import ptx
from example_runs import EXAMPLES

TABLE = Path(__file__).parent / "ptx.txt"


def run_program() -> None:
    for kernel, relation in program().values():
        kernel(relation)


RUNS: dict[str, Callable[[], object]] = {
    "program": run_program,
    **{name: lambda make=make: make()[0](0) for name, make in EXAMPLES.items()},
}

# ptxas unrolls the loop of the first too far for sm_90, and the second runs for one row; the table has the bytes.
SPILL = {"ebb_measure_bends", "ebb_judge_step"}


@pytest.mark.parametrize("name", RUNS)
def test_what_kernels_take_on_gpus(name: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    ptx.require()
    with ptx.emitting(monkeypatch) as made:
        RUNS[name]()
    spilled = [
        (capability, entry)
        for capability, text in made.images
        for entry, resources in ptx.assembled(text, capability).items()
        if resources.spilled and entry not in SPILL
    ]
    assert spilled == []
    ptx.check_section(TABLE, name, ptx.rows_of(made.images), update=request.config.getoption("--update-golden"))
