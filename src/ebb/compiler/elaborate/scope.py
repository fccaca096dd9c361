"""Names: which are locals of a function, what the others are outside, and which locals surely have a value."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

from ebb.compiler import kir
from ebb.compiler.elaborate.source import Scope, SourceFunction
from ebb.compiler.elaborate.values import Value
from ebb.compiler.host import HostCell, HostConst, HostExpr, HostGlobal
from ebb.diagnostics.span import Span
from ebb.records import field, record

AMBIGUOUS = "on two ways to this place a loop makes it two different things"


@record
class Variable:
    """A local that holds a value of one type."""

    local: kir.Local
    span: Span


@record
class Bound:
    """A local that is known when the kernel is compiled: what an argument is, a query, an unrolled variable."""

    value: Value
    span: Span


@record(frozen=False)
class Stores:
    """How often the names of one function are assigned: in all, by ``=`` and by ``for``; and where first."""

    count: Counter[str] = field(default_factory=Counter[str])
    plain: Counter[str] = field(default_factory=Counter[str])
    loops: Counter[str] = field(default_factory=Counter[str])
    first: dict[str, ast.Name] = field(default_factory=dict[str, ast.Name])


Binding: TypeAlias = Variable | Bound

State: TypeAlias = "Mapping[str, Binding] | None"
"""What surely has a value at a place of the program, and which; None where no way leads there."""


@record(frozen=False)
class Loop:
    """A loop around the statements being elaborated.

    ``breaks`` and ``continues`` are the states at each. ``reads`` has where each binding was first read in the loop, by
    name and identity. An unrolled loop is left by labels.
    """

    breaks: list[State] = field(default_factory=list[State])
    continues: list[State] = field(default_factory=list[State])
    reads: dict[tuple[str, int], Span] = field(default_factory=dict[tuple[str, int], Span])
    end: kir.Label | None = None
    turn: kir.Label | None = None


@record(frozen=False)
class Returns:
    """The returns of a function: where they lead, and what they give.

    ``nested``: some return is not the last statement, so that it must leave a block. ``values`` has for each whether it
    is written as a tuple, the value, and the place.
    """

    label: kir.Label
    nested: bool
    used: bool = False
    values: list[tuple[bool, Value | None, Span]] = field(default_factory=list[tuple[bool, "Value | None", Span]])


@record(frozen=False)
class Frame:
    """A function being elaborated: the kernel, or a func or member that is inlined into it.

    Attributes:
        locals: the names that are local to it.
        bindings: what each name was last bound to, on whatever way.
        live: what the names that surely have a value here are bound to; None where no way leads here.
        lost: why names that have been bound may have no value.
    """

    source: SourceFunction
    title: str
    stores: Stores
    locals: frozenset[str]
    returns: Returns
    parent: Frame | None = None
    call: Span | None = None
    bindings: dict[str, Binding] = field(default_factory=dict[str, Binding])
    live: State = field(default_factory=dict[str, Binding])
    lost: dict[str, str] = field(default_factory=dict[str, str])
    loops: list[Loop] = field(default_factory=list[Loop])

    def bind(self, name: str, binding: Binding) -> None:
        """Says that ``name`` is ``binding`` from here on."""
        self.bindings[name] = binding
        if self.live is not None:
            self.live = {**self.live, name: binding}

    def binding(self, name: str) -> Binding | None:
        """What ``name`` is bound to here, or where that is not sure, was last."""
        return (self.live or self.bindings).get(name) or self.bindings.get(name)

    def forget(self, names: set[str]) -> None:
        """Says that ``names`` are bound to nothing from here on."""
        self.bindings = {name: binding for name, binding in self.bindings.items() if name not in names}
        if self.live is not None:
            self.live = {name: binding for name, binding in self.live.items() if name not in names}

    def join(self, states: list[State]) -> None:
        """Several ways meet here. A name that is bound differently on two of them is bound to nothing from here on."""
        reached = [state for state in states if state is not None]
        if not reached:
            self.live = None
            return
        common = set[str](reached[0]).intersection(*reached[1:])
        same = {name for name in common if all(state[name] is reached[0][name] for state in reached)}
        self.lost |= {name: AMBIGUOUS for name in common - same}
        self.live = {name: binding for name, binding in reached[0].items() if name in same}

    def once(self, name: str) -> bool:
        """Whether ``name`` is bound in one place of the function only, a parameter by its call."""
        return self.stores.count[name] + (name in parameter_names(self.source.node)) == 1

    def rebinds(self, name: str) -> bool:
        """Whether ``=`` gives ``name`` another value than its first."""
        return self.stores.plain[name] + (name in parameter_names(self.source.node)) > 1

    def only_loops(self, name: str) -> bool:
        """Whether ``name`` is bound by ``for`` alone."""
        return self.stores.count[name] == self.stores.loops[name] and name not in parameter_names(self.source.node)


def parameter_names(node: ast.FunctionDef) -> list[str]:
    return [each.arg for each in (*node.args.posonlyargs, *node.args.args)]


def find_stores(node: ast.FunctionDef) -> Stores:
    """How the body of a function assigns names; parts of a local (``x[0] = e``) count as the local."""
    known = _stores.get(node)
    if known is None:
        known = _stores[node] = _find_stores(node)
    return known


_stores: WeakKeyDictionary[ast.FunctionDef, Stores] = WeakKeyDictionary()
"""What has been found, as long as there is the tree: functions are inlined again and again."""


def _find_stores(node: ast.FunctionDef) -> Stores:
    stores = Stores()
    for statement in _statements(node.body):
        match statement:
            case ast.Assign(targets=targets):
                for target in targets:
                    _add(stores, target, stores.plain)
            case ast.AnnAssign(target=target, value=value) if value is not None:
                _add(stores, target, stores.plain)
            case ast.AugAssign(target=target):
                _add(stores, target, None)
            case ast.For(target=target):
                _add(stores, target, stores.loops)
            case _:
                pass
    return stores


def rejected_names(node: ast.FunctionDef) -> frozenset[str]:
    """The names that Python would bind in the function by syntax that kernels do not have: that is reported itself."""
    return frozenset(name for each in ast.walk(node) if each is not node for name in _bound_by_rejected(each))


def _bound_by_rejected(node: ast.AST) -> tuple[str, ...]:
    match node:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            return (name,)
        case ast.alias(name=name, asname=other):
            return (other or name.partition(".")[0],)
        case ast.NamedExpr(target=target):
            return (target.id,)
        case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)):
            return (name,)
        case ast.withitem(optional_vars=ast.Name(id=name)):
            return (name,)
        case _:
            return ()


def raw_lookup(source: SourceFunction, name: str) -> tuple[HostExpr, Any] | None:
    """What ``name`` is outside the function now, or None where it is nothing (yet)."""
    found = outside(source, name)
    if source.trail is not None:
        source.trail.looked(source.function, name, None if found is None else found[0])
    return found


def outside(source: SourceFunction | Scope, name: str) -> tuple[HostExpr, Any] | None:
    """``raw_lookup`` that nobody takes notice of."""
    if name in source.cells:
        cell = source.cells[name]
        try:
            return HostCell(name, cell), cell.cell_contents
        except ValueError:
            return None
    if name in source.namespace:
        return HostGlobal(name, source.namespace), source.namespace[name]
    if name in source.builtins:
        found = source.builtins[name]
        return HostConst(found), found
    return None


def visible_names(frame: Frame) -> tuple[str, ...]:
    """The names that can be used in a function, to suggest one of them."""
    source = frame.source
    return tuple(
        dict.fromkeys((*frame.bindings, *source.cells, *source.namespace, "range", "len", "min", "max", "abs"))
    )


def _add(stores: Stores, target: ast.expr, kind: Counter[str] | None) -> None:
    match target:
        case ast.Tuple(elts=elements) | ast.List(elts=elements):
            for element in elements:
                _add(stores, element, kind)
        case ast.Name(id=name):
            stores.count[name] += 1
            stores.first.setdefault(name, target)
            if kind is not None:
                kind[name] += 1
        case ast.Subscript(value=base):
            _add(stores, base, None)
        case ast.Attribute(value=base, attr="x" | "y" | "z" | "w"):
            _add(stores, base, None)
        case _:
            pass


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for statement in body:
        yield statement
        for name in ("body", "orelse"):
            inner = getattr(statement, name, [])
            if not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                yield from _statements(inner)
