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
from .kernel_text import KernelText, kernels
from .worlds import World, worlds

_numbers = itertools.count()


@dataclass(frozen=True)
class Program:
    """A kernel's text and the world that it is to run in."""

    world: World
    kernel: KernelText

    @property
    def relation(self) -> ebb.Relation:
        return self.world.relations[self.kernel.relation]

    def __repr__(self) -> str:
        sizes = {name: relation.shape for name, relation in self.world.relations.items()}
        return f"a program on {self.kernel.relation} of {sizes}, grouped by {self.world.grouped}:\n{self.kernel.text}"


@st.composite
def programs(draw: Any) -> Program:
    world = draw(worlds())
    return Program(world, draw(kernels(world.grouped)))


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


def orders(program: Program, seed: int) -> tuple[Any, Any]:
    """Two random orders of the rows of the kernel."""
    random = np.random.default_rng(seed)
    return random.permutation(program.relation.size), random.permutation(program.relation.size)
