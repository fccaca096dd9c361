"""Generated kernels, compiled: a world, a text, and what the compiler made of it."""

from __future__ import annotations

import itertools
import linecache
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

import ebb
from ebb.backends.reference import interpreter
from ebb.compiler import kir
from ebb.compiler.arguments import uniform_values
from ebb.compiler.elaborate.elaborate import elaborate
from ebb.compiler.kir_walk import queried_fields
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.stencil import check_stencil, collect_stencil

from .kernel_text import KernelText, write_kernel
from .worlds import World, build_world

_numbers = itertools.count()


@dataclass(frozen=True)
class Program:
    """A kernel's text and the world that it is to run in."""

    world: World
    kernel: KernelText
    seed: int

    @property
    def relation(self) -> ebb.Relation:
        return self.world.relations[self.kernel.relation]

    def __repr__(self) -> str:
        sizes = {name: relation.shape for name, relation in self.world.relations.items()}
        return f"a program on {self.kernel.relation} of {sizes}, grouped by {self.world.grouped}:\n{self.kernel.text}"


def programs(salt: int = 0) -> st.SearchStrategy[Program]:
    """Random programs. An example is a few bytes, so that no two are alike, and shrinks by losing statements and rows.

    Args:
        salt: other salts, other programs, also where Hypothesis takes the same bytes.
    """
    return st.binary(min_size=16, max_size=16).map(lambda data: _program(data, salt))


def _program(data: bytes, salt: int) -> Program:
    mask, size, *seeds = (int.from_bytes(data[at : at + 4], "big") for at in (0, 4, 8, 12))
    world = build_world(seeds[0] + salt, size)
    # Of 32 random bits half are 1; of the 16 that are left three quarters, so that most statements stay.
    return Program(world, write_kernel(seeds[1] + (salt << 32), mask | mask >> 16, world.grouped), sum(seeds))


@contextmanager
def defined(program: Program, text: str | None = None) -> Iterator[ebb.Kernel]:
    """The kernel ``k`` that the text defines, while Python keeps its source."""
    text = program.kernel.text if text is None else text
    filename = f"<kernel {next(_numbers)}>"
    linecache.cache[filename] = (len(text), None, text.splitlines(keepends=True), filename)
    names = program.world.names
    try:
        exec(compile(text, filename, "exec"), names)
        yield names["k"]
    finally:
        del linecache.cache[filename]


def elaborated(program: Program, text: str | None = None) -> kir.Kernel:
    """The KIR of the kernel.

    Raises:
        EbbError: the kernel is wrong.
    """
    with defined(program, text) as kernel:
        return elaborate(kernel.source, program.relation, (), ()).kernel


def accepted(program: Program) -> kir.Kernel | None:
    """The kernel where the compiler takes it; None where it raises an ``EbbError``. It may raise nothing else."""
    try:
        kernel = elaborated(program)
        check_phases(kernel)
        check_stencil(kernel, collect_stencil(kernel), program.relation)
    except ebb.EbbError as error:
        assert str(error).startswith("error[E")
        return None
    return kernel


def interpret(program: Program, kernel: kir.Kernel, order: Sequence[int] | None = None) -> dict[str, Any]:
    """What all places hold after ``kernel`` has run on the reference interpreter, rows in ``order``."""
    world = program.world
    world.restore()
    for index in queried_fields(kernel):
        assert index.grouping is not None
        index.grouping.refresh()
    interpreter.run(kernel, program.relation, uniform_values(kernel.name, kernel.uniforms, ()), order)
    for place in world.fields:
        place.changed()
    return world.state()


def orders(program: Program) -> tuple[Any, Any]:
    """Two random orders of the rows of the kernel."""
    random = np.random.default_rng(program.seed)
    return random.permutation(program.relation.size), random.permutation(program.relation.size)
