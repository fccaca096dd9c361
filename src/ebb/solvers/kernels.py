"""The kernels that solvers have in common: the product with a matrix, and preconditioners.

Each is made for one system and reads fields by their names. What differs with the type of the unknowns is a function of
kernels that is chosen when the kernel is made.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import ebb
from ebb.records import record
from ebb.solvers.options import Preconditioner
from ebb.solvers.system import Blocks, LinearSystem

Function: TypeAlias = Any
"""What ``ebb.func`` makes."""

Launches: TypeAlias = Callable[[], None]

_where: Any = ebb.where  # to type checkers it returns nothing, since it is of kernels only


@ebb.func
def _multiplied(a: Any, b: Any) -> Any:
    return a * b


@ebb.func
def _applied(a: Any, b: Any) -> Any:
    return a @ b


@ebb.func
def _inner(a: Any, b: Any) -> Any:
    return ebb.dot(a, b)


def dot_of(system: LinearSystem) -> Function:
    """The inner product of two values of the unknowns' type."""
    return _inner if system.is_vector else _multiplied


def freedom_of(system: LinearSystem) -> Function:
    """``f(v)``: whether a row is to be solved for."""
    if system.free is None:

        @ebb.func
        def always(v: Any) -> Any:
            return True

        return always
    free = system.free.name

    @ebb.func
    def is_free(v: Any) -> Any:
        return v[free]

    return is_free


def product_of(system: LinearSystem, source: str, target: str, go: ebb.Global, total: ebb.Global) -> Launches:
    """What launches target = A source, 0 in rows that are not free, and adds the product of the two to ``total``.

    Columns of rows that are not free drop out as long as ``source`` is 0 there. Nothing happens while ``go`` is 0.
    """
    dot, is_free, rows, product = dot_of(system), freedom_of(system), system.rows, system.product
    unknown = system.x.type
    if product is None:
        assert system.blocks is not None
        kernel = _product_kernel(system, system.blocks, source, target, go, total)
        return lambda: kernel(rows)

    @ebb.kernel
    def measure_product(v: Any) -> None:
        if go.value > 0:
            y = v[target] if is_free(v) else ebb.zeros(unknown)
            v[target] = y
            total.value += dot(v[source], y)

    def launch() -> None:
        product(source, target)
        measure_product(rows)

    return launch


def _product_kernel(
    system: LinearSystem, blocks: Blocks, source: str, target: str, go: ebb.Global, total: ebb.Global
) -> ebb.Kernel:
    dot, is_free, times = dot_of(system), freedom_of(system), _applied if system.is_vector else _multiplied
    unknown, row, column, matrix = system.x.type, blocks.row, blocks.column.name, blocks.matrix.name

    @ebb.kernel
    def multiply(v: Any) -> None:
        if go.value > 0:
            y = ebb.zeros(unknown)
            for e in _where(row, v):
                y += times(e[matrix], e[column][source])
            y = y if is_free(v) else ebb.zeros(unknown)
            v[target] = y
            total.value += dot(v[source], y)

    return multiply


# ---- Preconditioners ----


@record(eq=False)
class Preconditioning:
    """A preconditioner.

    Attributes:
        apply: ``f(v, r)`` of kernels: what it makes of a residual r at the row v, when r has changed.
        again: ``f(v, r)``: the same once more, in a later kernel.
        prepare: launched at the start of a solve, if not None.
        compute: if not None, it has to be launched when r has changed, before a kernel that applies.
    """

    apply: Function
    again: Function
    prepare: Launches | None = None
    compute: Launches | None = None


def preconditioning(
    system: LinearSystem, given: Preconditioner | None, prefix: str, residual: str, conditioned: str, faults: ebb.Global
) -> Preconditioning:
    """The preconditioner ``given``; what it stores is named after ``prefix``, and what blocks make of ``residual`` too.

    ``faults`` counts the rows of which ``prepare`` finds the diagonal not to be positive definite.
    """
    if given is None:
        return Preconditioning(_same, _same)
    if callable(given):
        field = system.work(f"{prefix}_z")
        taken = _taken_from(field)
        return Preconditioning(taken, taken, compute=lambda: _launch(given, residual, field))
    assert system.blocks is not None
    if given == "jacobi" or not system.is_vector:
        stored = system.work(f"{prefix}_inverse")
        kernel, apply = _inverted_diagonal(system, system.blocks, stored, faults), _multiplying_by(stored)
        return Preconditioning(apply, apply, prepare=lambda: kernel(system.rows))
    # What a block makes of a residual is kept: to read it takes less than to read the block once more.
    stored, field = system.work(f"{prefix}_inverses", system.blocks.matrix.type), system.work(f"{prefix}_{conditioned}")
    invert = _inverted_blocks(system, system.blocks, stored, faults)
    return Preconditioning(_applying(stored, field), _taken_from(field), prepare=lambda: invert(system.rows))


def _launch(given: Callable[[str, str], object], source: str, target: str) -> None:
    given(source, target)


def _inverted_blocks(system: LinearSystem, blocks: Blocks, stored: str, faults: ebb.Global) -> ebb.Kernel:
    is_free, row, column, matrix = freedom_of(system), blocks.row, blocks.column.name, blocks.matrix.name
    block, components = blocks.matrix.type, tuple(range(system.x.type.shape[0]))

    @ebb.kernel
    def invert_blocks(v: Any) -> None:
        a = ebb.zeros(block)
        for e in _where(row, v):
            if e[column] == v:
                a += e[matrix]
        sound = ebb.det(a) > 0
        for i in components:
            sound = sound and a[i, i] > 0
        free = is_free(v)
        v[stored] = ebb.inverse(a) if free else ebb.zeros(block)
        if free and not sound:
            faults.value += 1

    return invert_blocks


def _inverted_diagonal(system: LinearSystem, blocks: Blocks, stored: str, faults: ebb.Global) -> ebb.Kernel:
    is_free, row, column, matrix = freedom_of(system), blocks.row, blocks.column.name, blocks.matrix.name
    unknown, diagonal, all_of = system.x.type, _diagonal_of(system), ebb.all if system.is_vector else bool

    @ebb.kernel
    def invert_diagonal(v: Any) -> None:
        d = ebb.zeros(unknown)
        for e in _where(row, v):
            if e[column] == v:
                d += diagonal(e[matrix])
        free = is_free(v)
        v[stored] = 1 / d if free else ebb.zeros(unknown)
        if free and not all_of(d > 0):
            faults.value += 1

    return invert_diagonal


def _diagonal_of(system: LinearSystem) -> Function:
    if not system.is_vector:

        @ebb.func
        def itself(a: Any) -> Any:
            return a

        return itself
    unknown, components = system.x.type, tuple(range(system.x.type.shape[0]))

    @ebb.func
    def diagonal(a: Any) -> Any:
        d = ebb.zeros(unknown)
        for i in components:
            d[i] = a[i, i]
        return d

    return diagonal


@ebb.func
def _same(v: Any, r: Any) -> Any:
    return r


def _multiplying_by(stored: str) -> Function:
    @ebb.func
    def apply(v: Any, r: Any) -> Any:
        return v[stored] * r

    return apply


def _applying(stored: str, field: str) -> Function:
    @ebb.func
    def apply(v: Any, r: Any) -> Any:
        z = v[stored] @ r
        v[field] = z
        return z

    return apply


def _taken_from(field: str) -> Function:
    @ebb.func
    def taken(v: Any, r: Any) -> Any:
        return v[field]

    return taken
