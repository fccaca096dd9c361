"""What is edited is compiled again, and nothing else: the cache knows kernels by what they compile to."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

KERNELS = 20

HEAD = """
import ebb

rows = ebb.Relation("rows", size=3)
rows.new_field("x", ebb.float32, init=1.0)
"""

KERNEL = """
@ebb.kernel
def step{number}(r: rows):
    assert r.x >= 0.0, "negative"
    for turn in range({number}):
        r.x += {factor}
"""


def program(factors, above=""):
    kernels = "".join(KERNEL.format(number=number, factor=factor) for number, factor in enumerate(factors))
    launches = "".join(f"step{number}(rows)\n" for number in range(len(factors)))
    return f"{above}{HEAD}{kernels}\n{launches}print(rows.x.to_numpy().tolist())\n"


@pytest.fixture
def run(tmp_path):
    """Runs a program in a process of its own; returns what it printed and how many kernels it compiled."""
    cache, path = tmp_path / "cache", tmp_path / "program.py"

    def run(text):
        path.write_text(text)
        before = set(cache.glob("*.o"))
        environment = dict(os.environ, EBB_CACHE_DIR=str(cache), PYTHONDONTWRITEBYTECODE="1")
        done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, env=environment)
        assert done.returncode == 0, done.stderr
        return done.stdout, len(set(cache.glob("*.o")) - before)

    return run


def test_of_twenty_kernels_the_edited_one_is_compiled_again(run):
    factors = [0.5] * KERNELS
    first, compiled = run(program(factors))
    assert compiled == KERNELS + 1, "the driver too"
    # It is longer now, so that those below stand on other lines.
    edited = [0.5] * 7 + ["(0.25 +\n            0.5)"] + [0.5] * 12
    second, compiled = run(program(edited, above="# A remark.\n\n\n"))
    assert compiled == 1
    assert first != second


def test_what_is_edited_back_or_around_the_kernels_is_not_compiled(run):
    first, compiled = run(program([0.5, 1.5]))
    assert compiled == 3, "the driver too"
    for above in ("# A remark.\n", "import sys\n\nunused = 3\n"):
        assert run(program([0.5, 1.5], above)) == (first, 0)
    _, compiled = run(program([2.5, 1.5]))
    assert compiled == 1
    assert run(program([0.5, 1.5])) == (first, 0)
