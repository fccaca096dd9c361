"""A direct solve by SciPy, as the check of others, and where systems are small."""

from __future__ import annotations

from typing import Any

import numpy as np

import ebb
from ebb.solvers.iteration import Reason, Result
from ebb.solvers.system import LinearSystem


def direct(
    x: ebb.Field,
    b: ebb.Field,
    matrix: ebb.Field,
    *,
    row: str = "tail",
    column: str = "head",
    rows: ebb.Subset | None = None,
) -> Result:
    """Solves ``matrix @ x = b`` by SciPy's sparse LU factors (SuperLU).

    Args:
        x: the unknowns, which are overwritten.
        b: the right-hand side, a field of the same relation and type.
        matrix: the entries of the matrix, or its blocks, as in ``ConjugateGradients``.
        row: the key field of the matrix's relation that says in which row an entry stands.
        column: the key field that says in which column.
        rows: the rows to solve for, by default all; as in ``ConjugateGradients``.

    Returns:
        A result with the norms of the residual before and after, and no iterations. Where the matrix is singular, or
        numbers are not finite, ``x`` is what it was.

    Raises:
        RelationError: the fields make no linear system (E550), or SciPy's matrix cannot be had of them (E552).
        BackendError: SciPy is not installed.
    """
    system = LinearSystem(x, b, matrix, None, row, column, rows)
    assert system.blocks is not None
    whole = ebb.interop.bsr_matrix(system.blocks.matrix, row=system.blocks.row, col=system.blocks.column).tocsc()
    from scipy.sparse import linalg  # pyright: ignore[reportMissingTypeStubs]

    size = x.type.shape[0] if system.is_vector else 1
    kept = np.ones(system.rows.size, dtype=bool) if system.free is None else system.free.to_numpy()
    places = np.flatnonzero(np.repeat(kept, size))
    part: Any = whole[places][:, places].astype(np.float64)
    values = x.to_numpy().reshape(-1)
    right, start = b.to_numpy().reshape(-1)[places].astype(np.float64), values[places].astype(np.float64)
    before = float(np.linalg.norm(right - part @ start))
    if not np.isfinite(part.data).all() or not np.isfinite(right).all():
        return Result(0, np.array([before]), Reason.NOT_FINITE)
    library: Any = linalg
    try:
        found = library.splu(part).solve(right) if len(places) else right
    except RuntimeError:  # it says that the factor is exactly singular
        return Result(0, np.array([before]), Reason.BREAKDOWN)
    if not np.isfinite(found).all():
        return Result(0, np.array([before]), Reason.BREAKDOWN)
    values[places] = found
    x.load(values.reshape(x.relation.shape + x.type.shape))
    return Result(0, np.array([before, float(np.linalg.norm(right - part @ found))]), Reason.CONVERGED)
