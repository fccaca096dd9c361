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
    stored, field = system.work(f"{prefix}_factors", _factor_type(system)), system.work(f"{prefix}_{conditioned}")
    factor = _factored_blocks(system, system.blocks, stored, faults)
    return Preconditioning(_applying(system, stored, field), _taken_from(field), prepare=lambda: factor(system.rows))


def _launch(given: Callable[[str, str], object], source: str, target: str) -> None:
    given(source, target)


def _factor_type(system: LinearSystem) -> Any:
    """Of the lower triangle of a block, row by row, in float32.

    The inverse of a block is the product of its factor, transposed, with the factor. So what is stored with few digits
    is still symmetric and positive definite, and only a little another preconditioner; in an iteration it is a third
    of the bytes of the inverse in float64, which is what the pass over the residual mostly reads.
    """
    extent = system.x.type.shape[0]
    return ebb.vector(ebb.float32, extent * (extent + 1) // 2)


def _triangle(system: LinearSystem) -> tuple[tuple[int, int, int], ...]:
    """The row and the column of each number of a block up to the diagonal, and where it lies in a factor."""
    rows = range(system.x.type.shape[0])
    return tuple((i, j, i * (i + 1) // 2 + j) for i in rows for j in range(i + 1))


def _factored_blocks(system: LinearSystem, blocks: Blocks, stored: str, faults: ebb.Global) -> ebb.Kernel:
    is_free, row, column, matrix = freedom_of(system), blocks.row, blocks.column.name, blocks.matrix.name
    block, unknown, packed = blocks.matrix.type, system.x.type, _factor_type(system)
    components = tuple((i, tuple(range(i))) for i in range(unknown.shape[0]))
    triangle = _triangle(system)

    @ebb.kernel
    def factor_blocks(v: Any) -> None:
        a = ebb.zeros(block)
        for e in _where(row, v):
            if e[column] == v:
                a += e[matrix]
        # Of each unit vector what is orthogonal, by the block, to those before it; all of length 1.
        factor = ebb.zeros(block)
        packing = ebb.zeros(packed)
        sound = True
        for i, before in components:
            direction = ebb.zeros(unknown)
            direction[i] = 1
            for j in before:
                direction -= ebb.dot(a[i], factor[j]) * factor[j]
            square = ebb.dot(direction, a @ direction)
            sound = sound and square > 0
            factor[i] = direction / ebb.sqrt(square)
        for i, j, place in triangle:
            packing[place] = ebb.float32(factor[i, j])
        free = is_free(v)
        v[stored] = packing if free else ebb.zeros(packed)
        if free and not sound:
            faults.value += 1

    return factor_blocks


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


def _applying(system: LinearSystem, stored: str, field: str) -> Function:
    number, extent = system.scalar, system.x.type.shape[0]
    matrix = ebb.matrix(number, extent, extent)
    triangle = _triangle(system)

    @ebb.func
    def apply(v: Any, r: Any) -> Any:
        packing, factor = v[stored], ebb.zeros(matrix)
        for i, j, place in triangle:
            factor[i, j] = number(packing[place])
        z = (factor @ r) @ factor
        v[field] = z
        return z

    return apply


def _taken_from(field: str) -> Function:
    @ebb.func
    def taken(v: Any, r: Any) -> Any:
        return v[field]

    return taken
