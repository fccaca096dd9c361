"""What launches must know of kernels, kept between processes, so that a kernel in the cache is not even elaborated.

A file holds, for one function in one text and rows that look alike, the ways that its elaborations went
(``elaborate/trail.py``). Where one of them leads to the same words in this process, and its guards hold, the facts that
were found there hold here: elaboration would make the same kernel. Where nothing is found, or something cannot be kept,
the kernel is elaborated; so it is, too, when somebody asks for more than the facts.
"""

from __future__ import annotations

import marshal
from collections.abc import Callable, Sequence
from enum import Enum
from numbers import Rational
from typing import Any, TypeAlias, cast

import numpy as np

from ebb.backends import known
from ebb.backends.cache import Content, ObjectCache
from ebb.compiler import host, kir
from ebb.compiler.cost import Cost
from ebb.compiler.elaborate.calls import OnPythonNumbers
from ebb.compiler.elaborate.function import Func
from ebb.compiler.elaborate.guards import (
    ArrayGuard,
    Guard,
    IdentityGuard,
    RangeGuard,
    StructureGuard,
    TypeGuard,
    ValueGuard,
    host_identity,
    reader,
)
from ebb.compiler.elaborate.parameters import FieldName, ParameterType, annotated
from ebb.compiler.elaborate.scope import outside
from ebb.compiler.elaborate.source import Scope
from ebb.compiler.elaborate.trail import (
    Annotation,
    FuncEntered,
    MemberEntered,
    Name,
    Path,
    Step,
    Trail,
    Untold,
    World,
    found,
    function_of,
    function_text,
    named,
)
from ebb.compiler.facts import LaunchFacts
from ebb.compiler.kir_key import KernelKey
from ebb.compiler.lower.facts import FactSources
from ebb.compiler.outline import Group, Outline
from ebb.compiler.packing import Packing, Unpackable
from ebb.compiler.phases.order import InOrder
from ebb.compiler.phases.stencil import Move
from ebb.compiler.phases.table import FieldPhase, GlobalPhase, PhaseKind, PhaseTable
from ebb.compiler.pipeline import dumps
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.member import Member
from ebb.relations.reach import Pace, Reach
from ebb.relations.relation import Relation
from ebb.runtime.digest import key_of
from ebb.types.builtins import BUILTINS, Builtin
from ebb.types.types import KeyType, MatrixType, VectorType

MOST_WAYS = 8
"""How many elaborations of one function are kept: those on other objects, and for other values where these matter."""

_Way: TypeAlias = "tuple[Any, str, Any, Any]"
"""Steps, the words that they lead to, guards, and facts."""


class FactsFile:
    """The file of one kernel on one relation, with parameters of certain types."""

    def __init__(self, scope: Scope, relation: Relation, types: Sequence[ParameterType], kept: ObjectCache) -> None:
        self._scope = scope
        self._kept = kept
        self._ways: list[_Way] = []
        self._world = World()
        self._key = None if dumps(scope.function.__code__.co_name) or not kept.limit else self._name(relation, types)

    def find(self, parameters: tuple[Any, ...]) -> tuple[LaunchFacts, tuple[Guard, ...]] | None:
        """The facts and the guards of the kernel, if they are kept for what the host has now."""
        content = None if self._key is None else self._kept.get(self._key, Content.FACTS)
        self._ways = [] if content is None else marshal.loads(content)
        for way in self._ways:
            facts = self._follow(way, parameters)
            if facts is not None:
                return facts
        return None

    def put(self, trail: Trail, guards: tuple[Guard, ...], facts: LaunchFacts) -> None:
        """Keeps the facts of a kernel that has just been elaborated."""
        if self._key is None or not trail.whole:
            return
        view = _View(self._scope, self._world.copy(), trail)
        try:
            steps = [view.note(step) for step in trail.steps.values()]
            way = (steps, view.words(), [view.pack_guard(guard) for guard in guards], view.pack(facts))
        except Exception:  # besides what cannot be told or packed, whatever the user's objects raise
            return
        self._kept.put(self._key, marshal.dumps([way, *self._ways[: MOST_WAYS - 1]]), Content.FACTS)

    def _name(self, relation: Relation, types: Sequence[ParameterType]) -> str | None:
        state = known.package_state()
        text = function_text(self._scope.function, self._scope.text)
        if state is None or text is None:
            return None
        try:
            self._world.tell(relation)
            for type_ in types:
                self._world.tell(type_.name if isinstance(type_, FieldName) else type_)
        except Exception:  # whatever the user's objects raise
            return None
        return key_of("facts", state, np.__version__, text, repr(self._world.words))

    def _follow(self, way: _Way, parameters: tuple[Any, ...]) -> tuple[LaunchFacts, tuple[Guard, ...]] | None:
        steps, words, packed_guards, packed_facts = way
        view = _View(self._scope, self._world.copy(), None)
        try:
            for step in steps:
                view.take(step)
            if view.words() != words:
                return None
            guards = tuple([view.unpack_guard(each) for each in packed_guards])
        except Exception:  # whatever the user's objects raise: elaborating will say
            return None
        return (view.unpack(packed_facts), guards) if all([guard.holds(parameters) for guard in guards]) else None


class _View:
    """What is seen along the steps of one way."""

    def __init__(self, scope: Scope, world: World, trail: Trail | None) -> None:
        self._world = world
        self._trail = trail
        self._scopes = [scope]
        self._makers: dict[str, Callable[..., Any]] = {
            "thing": self._world.things.__getitem__,
            "field": self._field,
            "name": self._captured,
            "constant": host.HostConst,
            "default": self._default,
            "dict": dict,
            "list": list,
            "array": _array,
            "dtype": np.dtype,
            "found": found,
            "builtin": BUILTINS.__getitem__,
            "fraction": _fraction,
        }

    # ---- Steps ----

    def note(self, step: Step) -> Any:
        """Takes a step of the trail, and gives what ``take`` takes."""
        tree = (_NAME, step.function, step.name) if isinstance(step, Name) else self.pack(step)
        self.take(tree)
        return tree

    def take(self, tree: Any) -> None:
        """Looks where a step says, and puts into words what is there."""
        if tree[0] == _NAME:  # most are
            _, function, name = cast("tuple[str, int, str]", tree)
            self._tell_name(outside(self._scopes[function], name))
            return
        match self.unpack(tree):
            case Path(expr):
                self._world.tell(host.evaluate(expr, ()))
            case Annotation(function, name):
                self._world.tell(annotated(self._scopes[function], name))
            case FuncEntered(function, expr):
                func = host.evaluate(expr, ())
                if not isinstance(func, Func):
                    raise Untold
                self._enter(function, func.scope)
            case MemberEntered(function, relation, name, role):
                member = relation.attribute(name)
                if not isinstance(member, Member):
                    raise Untold
                self._enter(function, function_of(member, role))
            case step:
                raise Untold(step)

    def _tell_name(self, seen: tuple[host.HostExpr, Any] | None) -> None:
        match seen:
            case None:
                self._world.words.append("nothing")
            case (host.HostConst(), bool() | int() | float() as value):  # a builtin number, such as ``__debug__``
                self._world.words.append(repr(value))
            case (expr, value):
                self._world.words.append(type(expr).__name__)
                self._world.tell(value)

    def words(self) -> str:
        """All that was put into words, in short."""
        return key_of(repr(self._world.words))

    def _enter(self, number: int, scope: Scope) -> None:
        if number == len(self._scopes):
            self._scopes.append(scope)
            self._world.tell_function(scope)
            return
        known = self._scopes[number]
        same = known.function is scope.function and known.text == scope.text
        if not same or (known.locals is not scope.locals and (known.locals or scope.locals)):
            raise Untold

    # ---- Guards ----

    def pack_guard(self, guard: Guard) -> Any:
        """A guard as a tree; the object of an identity is found again, by the steps."""
        match guard:
            case IdentityGuard(expr):
                return "identity", self.pack(expr), None
            case TypeGuard(expr, _, type_):
                return "type", self.pack(expr), named(type_)
            case StructureGuard(expr, _, structure):
                return "structure", self.pack(expr), _pack_structure(structure)
            case RangeGuard(expr, _, fact) | ValueGuard(expr, _, fact):
                return type(guard).__name__, self.pack(expr), self.pack(fact)
            case ArrayGuard(expr, _, dtype, shape):
                return "array", self.pack(expr), (dtype.str, shape)

    def unpack_guard(self, tree: Any) -> Guard:
        """The guard of a tree."""
        kind, packed, fact = tree
        expr = self.unpack(packed)
        read = reader(expr)
        match kind:
            case "identity":
                return IdentityGuard(expr, read, read(()))
            case "type":
                return TypeGuard(expr, read, found(*fact))
            case "structure":
                return StructureGuard(expr, read, _unpack_structure(fact))
            case "array":
                return ArrayGuard(expr, read, np.dtype(fact[0]), fact[1])
            case "RangeGuard":
                return RangeGuard(expr, read, self.unpack(fact))
            case _:
                return ValueGuard(expr, read, self.unpack(fact))

    # ---- Trees ----

    def pack(self, thing: Any) -> Any:
        """The tree of ``thing``.

        Raises:
            Unpackable, Untold: it has none.
        """
        return _PACKING.pack(thing, self._pack_other)

    def unpack(self, tree: Any) -> Any:
        """The thing of a tree, about the objects of this process."""
        return _PACKING.unpack(tree, self._makers)

    def _pack_other(self, thing: Any) -> tuple[Any, ...]:
        match thing:
            case Field():
                if thing.relation.attribute(thing.name) is not thing:
                    raise Untold
                return "field", self._world.number(thing.relation), thing.name
            case Relation() | Global():
                return "thing", self._world.number(thing)
            case Builtin():
                return "builtin", thing.name
            case host.HostConst(value):
                return self._pack_constant(value)
            case host.HostCell() | host.HostGlobal():
                name = None if self._trail is None else self._trail.names.get(host_identity(thing))
                if name is None:
                    raise Untold
                return "name", name.function, name.name
            case _:
                return self._pack_python(thing)

    def _pack_python(self, thing: Any) -> tuple[Any, ...]:
        """What is not Ebb's."""
        match thing:
            case dict():
                return "dict", self.pack(tuple(cast("dict[Any, Any]", thing).items()))
            case list():
                return "list", self.pack(tuple(cast("list[Any]", thing)))
            case np.generic() | np.ndarray():
                return _pack_array(thing)
            case Rational():
                return "fraction", int(thing.numerator), int(thing.denominator)
            case _:
                return "found", *named(thing)

    def _pack_constant(self, value: Any) -> tuple[Any, ...]:
        """A literal by its value, and an array as the default argument that it is, since it may change in place."""
        if not isinstance(value, np.ndarray):
            return "constant", self.pack(value)
        for function, scope in enumerate(self._scopes):
            for place, default in enumerate(scope.function.__defaults__ or ()):
                if default is value:
                    return "default", function, place
        raise Untold

    def _default(self, function: int, place: int) -> host.HostExpr:
        return host.HostConst((self._scopes[function].function.__defaults__ or ())[place])

    def _field(self, relation: int, name: str) -> Field:
        return self._world.things[relation].attribute(name)

    def _captured(self, function: int, name: str) -> host.HostExpr:
        seen = outside(self._scopes[function], name)
        if seen is None:
            raise Untold
        return seen[0]


def _pack_array(array: Any) -> tuple[Any, ...]:
    if array.dtype.kind not in "biuf":
        raise Unpackable
    return "array", array.dtype.str, list(array.shape), array.tobytes(), isinstance(array, np.generic)


def _array(dtype: str, shape: tuple[int, ...], content: bytes, is_scalar: bool) -> Any:
    array = np.frombuffer(content, dtype=dtype).reshape(shape)
    return array[()] if is_scalar else array


def _fraction(numerator: int, denominator: int) -> Any:
    from fractions import Fraction  # here: few kernels have any

    return Fraction(numerator, denominator)


def _pack_structure(structure: Any) -> Any:
    if isinstance(structure, tuple):
        return [_pack_structure(part) for part in cast("tuple[Any, ...]", structure)]
    return named(structure)


def _unpack_structure(tree: Any) -> Any:
    if isinstance(tree, list):
        return tuple([_unpack_structure(part) for part in cast("list[Any]", tree)])
    return found(*tree)


_RECORDS: tuple[type[Any], ...] = (
    Name, Path, Annotation, FuncEntered, MemberEntered,
    host.HostParameter, host.HostAttribute, host.HostItem, host.HostOperation, host.HostAttempt,
    host.HostValue, OnPythonNumbers, VectorType, MatrixType, KeyType,
    LaunchFacts, Outline, KernelKey, FactSources, Cost, Group, PhaseTable, FieldPhase, GlobalPhase, Reach, Move,
)  # fmt: skip

_OPTIONS: tuple[type[Enum], ...] = (InOrder, PhaseKind, Pace, kir.ReduceOp, kir.Edge)

_NAME = Name.__name__

_PACKING = Packing(_RECORDS, _OPTIONS)
