"""Which keys of a kernel are centered: surely the kernel's own row."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from ebb.compiler import kir
from ebb.compiler.kir_walk import statements
from ebb.records import record
from ebb.relations.relation import Relation

_BINDS = (kir.Assign, kir.ForRange, kir.ForQuery)


@record
class Centered:
    """The locals of one kernel that hold its own row, by ``uid``."""

    relation: Relation
    locals: frozenset[int]

    def is_centered(self, key: kir.Expr) -> bool:
        """Whether ``key`` is the kernel's own row in every run: a centered local, or an identity affine map of one."""
        match key:
            case kir.ReadLocal(local):
                return local.uid in self.locals
            case kir.Affine(matrix, base):
                return key.type == self.relation.key_type and is_identity(matrix) and self.is_centered(base)
            case _:
                return False


def find_centered(kernel: kir.Kernel) -> Centered:
    """The centered keys of ``kernel``: its row, and each local bound in one place only, to a centered key."""
    bound = _bindings(kernel)
    assigned = _assigned_once(bound)
    assigned_row = any([stmt.local.uid == kernel.row.uid for stmt in bound])
    rows = frozenset[int]() if assigned_row else frozenset({kernel.row.uid})
    centered = Centered(kernel.relation, rows)
    while True:
        more = {uid for uid, value in assigned.items() if centered.is_centered(value)} - centered.locals
        if not more:
            return centered
        centered = Centered(kernel.relation, centered.locals | more)


def single_assignments(kernel: kir.Kernel) -> Mapping[int, kir.Expr]:
    """The value of each local that exactly one statement binds, where that is a whole assignment, by ``uid``."""
    return _assigned_once(_bindings(kernel))


def is_identity(matrix: tuple[tuple[kir.Entry, ...], ...]) -> bool:
    """Whether an affine map leaves the coordinates of its base as they are."""
    return all(
        entry == (1 if column == row else 0)
        for row, entries in enumerate(matrix)
        for column, entry in enumerate(entries)
    )


def _bindings(kernel: kir.Kernel) -> list[kir.Assign | kir.ForRange | kir.ForQuery]:
    """The statements of the kernel that bind a local."""
    return [stmt for stmt in statements(kernel.body) if isinstance(stmt, _BINDS)]


def _assigned_once(bound: list[kir.Assign | kir.ForRange | kir.ForQuery]) -> dict[int, kir.Expr]:
    counts = Counter([stmt.local.uid for stmt in bound])
    return {
        stmt.local.uid: stmt.value
        for stmt in bound
        if isinstance(stmt, kir.Assign) and not stmt.indices and counts[stmt.local.uid] == 1
    }
