"""Which locals of a kernel need no variable: bound once, and read only where that binding surely holds."""

from __future__ import annotations

from collections import defaultdict

from ebb.compiler import kir
from ebb.compiler.kir_walk import bodies, operands, subexpressions
from ebb.records import field, record

_Path = tuple[int, ...]
_FORCED = 2


@record(frozen=False)
class _Uses:
    """What the statements do to each local, by ``uid``. A path names the bodies around a statement, outermost first."""

    locals: dict[int, kir.Local] = field(default_factory=dict[int, kir.Local])
    bindings: defaultdict[int, int] = field(default_factory=lambda: defaultdict[int, int](int))
    bound_at: dict[int, _Path] = field(default_factory=dict[int, _Path])
    read_at: defaultdict[int, list[_Path]] = field(default_factory=lambda: defaultdict[int, list[_Path]](list))
    paths: int = 0

    def bind(self, local: kir.Local, path: _Path, weight: int = 1) -> None:
        self.locals[local.uid] = local
        self.bindings[local.uid] += weight
        self.bound_at[local.uid] = path

    def read(self, expr: kir.Expr, path: _Path) -> None:
        for part in subexpressions(expr):
            if isinstance(part, kir.ReadLocal):
                self.read_at[part.local.uid].append(path)
            elif isinstance(part, kir.Component) and isinstance(part.operand, kir.ReadLocal) and _computed(part):
                self.bindings[part.operand.local.uid] += _FORCED

    def body(self, body: kir.Body, path: _Path) -> None:
        self.paths += 1
        inner = (*path, self.paths)
        for stmt in body:
            for operand in operands(stmt):
                self.read(operand, inner)
            match stmt:
                case kir.Assign(local, indices):
                    self.bind(local, inner, _FORCED if indices else 1)
                case kir.ForRange(local) | kir.ForQuery(local):
                    self.bind(local, (*inner, self.paths + 1))
                case _:
                    pass
            for nested in bodies(stmt):
                self.body(nested, inner)


def _computed(part: kir.Component) -> bool:
    """Whether it takes running the kernel to know which component it is."""
    return not all([isinstance(index, kir.Const) for index in part.indices])


def variables(kernel: kir.Kernel) -> tuple[kir.Local, ...]:
    """The locals of ``kernel`` that need a variable; all others stand for the value that they are bound to."""
    uses = _Uses()
    uses.bind(kernel.row, ())
    uses.body(kernel.body, ())
    return tuple(local for uid, local in uses.locals.items() if not _is_value(uses, uid))


def _is_value(uses: _Uses, uid: int) -> bool:
    home = uses.bound_at[uid]
    return uses.bindings[uid] == 1 and all(path[: len(home)] == home for path in uses.read_at[uid])
