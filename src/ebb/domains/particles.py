"""Particles: rows with a position, and keys into the grids that they move through."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from keyword import iskeyword
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

import ebb
from ebb.domains.errors_particles import BadParticles, CannotCouple, NowherePlaced
from ebb.domains.grid import Grid
from ebb.domains.grid_locate import LocatedRelation
from ebb.domains.io.points import read_points, write_points
from ebb.errors import RelationError

_PRECISIONS = {ebb.float32: np.dtype(np.float32), ebb.float64: np.dtype(np.float64)}


class Particles(ebb.Relation):
    """Points as a relation: each row has a position, ``pos``, and whatever fields are added.

    To couple particles with a grid is to give them keys of its elements. ``couple`` adds the fields ``cell``, the cell
    that a particle is in, and ``dual_cell``, the square or box between the centres of cells that it is in. In a kernel
    the values of the cells around a particle ``p`` are then ``p.dual_cell.cell(i, j).vel`` for ``i`` and ``j`` from 0
    to 1, and ``p.dual_cell.local(p.pos)`` is where it lies between them, which makes the weights of an interpolation.
    When the particles have moved, ``locate`` sets the keys anew; a kernel may as well do it for its own row:
    ``p.dual_cell = grid.dual_locate(p.pos)``.

    Attributes:
        dimension: the number of components of ``pos``.
    """

    __slots__ = ("_couplings", "dimension")

    def __init__(
        self, positions: npt.ArrayLike, *, precision: Any = ebb.float32, name: str = "particles", reorder: bool = True
    ) -> None:
        """A particle at each of ``positions``.

        Args:
            positions: finite numbers, of the shape (n, d) with d from 1 to 3.
            precision: the type of the numbers of ``pos``, ``ebb.float32`` or ``ebb.float64``.
            name: of the relation, for messages.
            reorder: whether the rows may be stored in another order (see ``Relation``).

        Raises:
            RelationError: the positions are no such array (E540), one is not finite (E541), or as ``Relation``.
        """
        points = _checked_positions(positions, precision)
        super().__init__(name, size=len(points), reorder=reorder)
        self.dimension: int = points.shape[1]
        self._couplings: list[tuple[LocatedRelation, ebb.Field]] = []
        self.new_field("pos", ebb.vector(precision, self.dimension), init=points)

    @classmethod
    def from_arrays(
        cls, positions: npt.ArrayLike, *, precision: Any = ebb.float32, name: str = "particles", **fields: npt.ArrayLike
    ) -> Particles:
        """Particles with more fields than ``pos``: ``Particles.from_arrays(pos, vel=vel, kind=kind)``.

        Args:
            positions: as for ``Particles``.
            precision: of ``pos`` and of all fields of floats.
            name: of the relation.
            fields: by name, arrays of a number, bool, vector or matrix for each particle; their kind of numbers decides
                the type of the field.

        Raises:
            RelationError: the positions or an array do not fit (E540, E541), or a name is bad or taken.
        """
        particles = cls(positions, precision=precision, name=name)
        for field, given in fields.items():
            values = np.asarray(given)
            particles.new_field(field, _type_of(field, values, particles.size, precision), init=values)
        return particles

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        *,
        dimension: int | None = None,
        precision: Any = ebb.float32,
        name: str = "particles",
    ) -> Particles:
        """Particles at the points of a file, with its other values for each point as fields.

        Args:
            path: an archive of NumPy's (.npz) with an array ``pos``, or any file that meshio reads (.vtu, .ply, ...).
            dimension: how many coordinates to take, of the three that most formats have; those left out must be 0.
            precision: of ``pos`` and of all fields of floats.
            name: of the relation.

        Raises:
            MeshFormatError: the file cannot be read, or holds no such points; a coordinate is not finite.
            RelationError: an argument is wrong (E540), or a name in the file is none for a field.
            BackendError: the format is one of meshio's, and meshio is not installed.
        """
        if precision not in _PRECISIONS:
            raise RelationError(BadParticles("precision", _PRECISION, repr(precision)))
        if dimension is not None and _checked_count("dimension", dimension) not in (1, 2, 3):
            raise RelationError(BadParticles("dimension", "1, 2 or 3", repr(dimension)))
        found = read_points(path, dimension, precision)
        return cls.from_arrays(found.points, precision=precision, name=name, **found.values)

    def save(self, path: str | PathLike[str], fields: Iterable[str | ebb.Field] | None = None) -> None:
        """Write the particles into an archive of NumPy's (.npz), or in the format of meshio's that the suffix names.

        Archives hold everything as it is. The others have three coordinates, of which the last are 0 where ``pos`` has
        fewer, 0 and 1 for bools, and the components of a matrix in a row.

        Args:
            path: where to.
            fields: to save besides ``pos``: names, or fields of these particles; by default all that hold no keys.

        Raises:
            MeshFormatError: the file cannot be written, or has no place for a field.
            BackendError: the format is one of meshio's, and meshio is not installed.
        """
        write_points(path, self, fields)

    @classmethod
    def random(
        cls, count: int, low: Any, high: Any, *, seed: int = 0, precision: Any = ebb.float32, name: str = "particles"
    ) -> Particles:
        """``count`` particles spread evenly by chance over the box from ``low`` to ``high``.

        Args:
            count: how many.
            low: the lower corner, a number a dimension.
            high: the upper corner.
            seed: of the random numbers: the same seed gives the same particles.
            precision: as for ``Particles``.
            name: of the relation.

        Raises:
            RelationError: the count or the corners are none (E540).
        """
        wanted = _checked_count("count", count)
        first, last = (_checked_corner(name, corner) for name, corner in (("low", low), ("high", high)))
        if first.shape != last.shape:
            raise RelationError(BadParticles("high", f"{first.size} numbers, as low has", repr(high)))
        share = np.random.default_rng(seed).random((wanted, first.size))
        return cls(first + share * (last - first), precision=precision, name=name)

    @classmethod
    def in_cells(cls, grid: Grid, each: int = 1, *, precision: Any = None, name: str = "particles") -> Particles:
        """Particles in regular places: ``each`` along each side of each cell, one in its centre if ``each`` is 1.

        They are numbered as cells are, the last index first.

        Args:
            grid: whose cells they fill.
            each: how many particles lie along each side of a cell.
            precision: as for ``Particles``; by default that of the grid.
            name: of the relation.

        Raises:
            RelationError: ``each`` is no count (E540).
        """
        along = _checked_count("each", each)
        axes = [
            start + length * (np.arange(count * along) + 0.5) / max(count * along, 1)
            for start, length, count in zip(grid.origin, grid.extent, grid.shape, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        return cls(points, precision=grid.precision if precision is None else precision, name=name)

    def couple(self, grid: Grid, *, cell: str | None = "cell", dual_cell: str | None = "dual_cell") -> None:
        """Adds keys of the cell and of the dual cell of ``grid`` that each particle is in, and sets them.

        Particles outside of a grid belong to its outermost cells, or wrap where it is periodic. They may be coupled
        with several grids, by other names.

        Args:
            grid: of as many dimensions as ``pos`` has components.
            cell: the name of the field for cells; None for none.
            dual_cell: the name of the field for dual cells; None for none.

        Raises:
            RelationError: the grid has other dimensions or no dual cells (E542), or a name is bad or taken.
            KernelAssertionError: a position is not a number; the keys are added, but not set.
        """
        self._check_coupling(grid, cell, dual_cell)
        wanted = [(name, elements) for name, elements in ((cell, grid.cells), (dual_cell, grid.dual_cells)) if name]
        # A name that cannot be had comes first, so that it is refused before anything has been added.
        wanted.sort(key=lambda each: self._is_free(each[0]))
        added = [(elements, self.new_field(name, elements)) for name, elements in wanted]
        self._couplings.extend(added)
        self._place(added)

    def locate(self) -> None:
        """Sets the keys of all couplings to the cells and dual cells that the particles are in now.

        Raises:
            KernelAssertionError: a position is not a number; the error names the row.
        """
        self._place(self._couplings)

    def _place(self, couplings: list[tuple[LocatedRelation, ebb.Field]]) -> None:
        for elements, keys in couplings:
            elements.point_locate(keys, self.pos)

    def _is_free(self, name: str) -> bool:
        return name.isidentifier() and not iskeyword(name) and not hasattr(self, name)

    def _check_coupling(self, grid: Grid, cell: str | None, dual_cell: str | None) -> None:
        if len(grid.shape) != self.dimension:
            complaint = f"positions have {self.dimension} components, and the grid {len(grid.shape)} dimensions"
            raise RelationError(CannotCouple(complaint))
        for name in (cell, dual_cell):
            if not isinstance(name, str | None):  # pyright: ignore[reportUnnecessaryIsInstance]
                raise RelationError(CannotCouple(f"{name!r} is no name of a field"))
        if cell and cell == dual_cell:
            raise RelationError(CannotCouple(f"cells and dual cells cannot both be called {cell!r}"))
        if dual_cell and not grid.dual_cells.size:
            complaint = f"a grid of the shape {grid.shape} has no dual cells"
            raise RelationError(CannotCouple(complaint, ("leave their keys out: dual_cell=None",)))


def _checked_positions(positions: Any, precision: Any) -> npt.NDArray[Any]:
    if precision not in _PRECISIONS:
        raise RelationError(BadParticles("precision", _PRECISION, repr(precision)))
    try:
        given = np.asarray(positions)
    except ValueError:
        raise RelationError(BadParticles("positions", _POSITIONS, "rows of different lengths")) from None
    if given.dtype.kind not in "iuf" or given.ndim != 2 or not 1 <= given.shape[1] <= 3:
        raise RelationError(BadParticles("positions", _POSITIONS, _describe(given)))
    with np.errstate(over="ignore"):
        points: npt.NDArray[Any] = given.astype(_PRECISIONS[precision])
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise RelationError(NowherePlaced(row, tuple(given[row].tolist()), str(points.dtype)))
    return points


_PRECISION = "ebb.float32 or ebb.float64"
_POSITIONS = "numbers of the shape (n, d) with d from 1 to 3"


def _checked_count(argument: str, count: Any) -> int:
    try:
        found = operator.index(count)
    except TypeError:
        found = -1
    if found < 0 or isinstance(count, bool):
        raise RelationError(BadParticles(argument, "a number of particles", repr(count)))
    return found


def _checked_corner(argument: str, corner: Any) -> npt.NDArray[np.float64]:
    try:
        found = np.asarray(corner, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty((0, 0))
    if found.ndim != 1 or not 1 <= found.size <= 3 or not np.isfinite(found).all():
        raise RelationError(BadParticles(argument, "one to three finite numbers, a corner", repr(corner)))
    return found


def _type_of(name: str, values: npt.NDArray[Any], count: int, precision: Any) -> Any:
    """The type of a field that takes ``values``."""
    scalars = {"b": ebb.bool_, "f": precision}
    integers = {4: (ebb.int32, ebb.uint32), 8: (ebb.int64, ebb.uint64)}
    scalar = scalars.get(values.dtype.kind)
    if scalar is None and values.dtype.kind in "iu":
        scalar = integers[8 if values.dtype.itemsize == 8 else 4][values.dtype.kind == "u"]
    if scalar is None or not 1 <= values.ndim <= 3 or len(values) != count or 0 in values.shape[1:]:
        expected = f"numbers or bools, a number, vector or matrix for each of {count} particles"
        raise RelationError(BadParticles(name, expected, _describe(values)))
    if values.ndim == 1:
        return scalar
    return (ebb.vector if values.ndim == 2 else ebb.matrix)(scalar, *values.shape[1:])


def _describe(array: npt.NDArray[Any]) -> str:
    return f"{array.dtype} of the shape {array.shape}"
