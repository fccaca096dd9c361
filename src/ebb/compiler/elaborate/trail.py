"""What elaboration looked at outside of a kernel's text, so that another process can look again.

Elaboration is a function of the text of the kernel and of the functions that it inlines, of the types of the
parameters, and of what it sees of Python's objects. It sees those in few places, and each of them notes here what it
looked at: names outside of functions (``raw_lookup``), attributes and elements of what they hold (``captured``),
annotations (``annotation``), and which function is inlined (``entered``). ``World`` puts into words what is there: of a
relation everything that a kernel can tell, of a number the type, of other things what they are. Values of numbers are
left to the guards, which hold what was needed of them. So where the same steps lead to the same words in another
process, and the guards hold, elaboration would make the same kernel there, but for which objects it is about; and these
have the same numbers in both worlds.

What cannot be put into words, or is reached by no step, is ``Untold``: such a kernel is elaborated in each process.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, TypeAlias, cast
from weakref import WeakKeyDictionary

import numpy as np

from ebb.compiler.elaborate.function import Func, member_function
from ebb.compiler.elaborate.guards import host_identity
from ebb.compiler.elaborate.intrinsics import Intrinsic
from ebb.compiler.elaborate.source import Scope, SourceFunction, text_key
from ebb.compiler.host import HostAttribute, HostCell, HostExpr, HostGlobal, HostItem
from ebb.records import record, replace
from ebb.relations.field import Field
from ebb.relations.globals import Constant, Global
from ebb.relations.member import Member
from ebb.relations.relation import Relation
from ebb.relations.subset import Subset
from ebb.types.builtins import Builtin, Form
from ebb.types.types import KeyType, MatrixType, ScalarType, VectorType


class Untold(Exception):  # noqa: N818 - it is no error: such a kernel is elaborated
    """Something cannot be put into words."""


@record
class Name:
    """A name outside of a function, which is told by its number."""

    function: int
    name: str


@record
class Path:
    """An attribute or an element of something captured."""

    host: HostExpr


@record
class Annotation:
    """The annotation of a parameter."""

    function: int
    name: str


@record
class FuncEntered:
    """A function is reached as that of a captured func."""

    function: int
    host: HostExpr


@record
class MemberEntered:
    """A function is reached as that of a member: its value, its setter, or a reducer by the operator."""

    function: int
    relation: Relation
    name: str
    role: str


Step: TypeAlias = Name | Path | Annotation | FuncEntered | MemberEntered


class Trail:
    """The steps of one elaboration.

    Attributes:
        steps: in the order in which they were made, each once.
        names: which names the captured variables and globals are, by ``host_identity``.
        whole: whether another process can go the same way.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        """Nothing has been looked at but the kernel ``function``, which is number 0."""
        self.steps: dict[Any, Step] = {}
        self.names: dict[Any, Name] = {}
        self.whole = True
        self._numbers: dict[Callable[..., Any], int] = {function: 0}
        self._funcs: dict[int, HostExpr] = {}

    def looked(self, function: Callable[..., Any], name: str, found: HostExpr | None) -> None:
        """Notes that a name was looked up."""
        step = Name(self._numbers[function], name)
        self.steps[step] = step
        if isinstance(found, HostCell | HostGlobal):
            self.names.setdefault(host_identity(found), step)

    def captured(self, host: HostExpr, value: Any) -> None:
        """Notes that ``host``, which is ``value``, stands for something in the kernel."""
        if isinstance(host, HostAttribute | HostItem):
            self.steps.setdefault(host_identity(host), Path(host))
        if isinstance(value, Func):
            self._funcs.setdefault(id(value), host)

    def annotated(self, function: Callable[..., Any], name: str) -> None:
        """Notes that an annotation was evaluated."""
        step = Annotation(self._numbers[function], name)
        self.steps[step] = step

    def func_entered(self, func: Func, source: SourceFunction) -> SourceFunction:
        """Notes that the body of a func is elaborated, and gives its source, which notes what is looked at there."""
        host = self._funcs.get(id(func))
        number = self._number(source.function)
        if host is None:
            self.whole = False
        else:
            self.steps.setdefault((number, host_identity(host)), FuncEntered(number, host))
        return replace(source, trail=self)

    def member_entered(
        self, member: Member, function: Callable[..., Any], source: SourceFunction
    ) -> SourceFunction:  # fmt: skip
        """``func_entered`` of one of the functions of ``member``."""
        roles = [role for role, each in _roles(member).items() if each is function]
        number = self._number(source.function)
        for role in roles:
            step = MemberEntered(number, member.relation, member.name, role)
            self.steps[step] = step
        self.whole = self.whole and bool(roles)
        return replace(source, trail=self)

    def _number(self, function: Callable[..., Any]) -> int:
        return self._numbers.setdefault(function, len(self._numbers))


def function_of(member: Member, role: str) -> Scope:
    """One of the functions of a member.

    Raises:
        Untold: there is none that can be read.
    """
    function = member_function(cast("Callable[..., Any]", _roles(member).get(role)))
    if not isinstance(function, FunctionType):
        raise Untold
    return Scope(function, None, _NO_LOCALS)


_NO_LOCALS: Mapping[str, Any] = {}


def _roles(member: Member) -> Mapping[str, Callable[..., Any] | None]:
    return {"value": member.function, "setter": member.setter_function, **member.reducers}


class World:
    """What is to be known of the objects that a kernel is about, in words. Each has a number, for when it comes again.

    Attributes:
        words: what has been told.
        things: the relations, globals and funcs in it, by their numbers.
    """

    def __init__(self) -> None:
        self.words: list[str] = []
        self.things: list[Any] = []
        self._numbers: dict[int, int] = {}

    def copy(self) -> World:
        """The same so far."""
        other = World()
        other.words, other.things, other._numbers = self.words.copy(), self.things.copy(), self._numbers.copy()
        return other

    def number(self, thing: Any) -> int:
        """The number of a relation or a global.

        Raises:
            Untold: it is nowhere in this world.
        """
        try:
            return self._numbers[id(thing)]
        except KeyError:
            raise Untold from None

    def tell(self, value: Any) -> None:
        """Puts ``value`` into words.

        Raises:
            Untold: that cannot be done.
        """
        tell = _TELL.get(cast("type[Any]", type(value)))
        if tell is None:
            tell = next((tell for kind, tell in _KINDS if isinstance(value, kind)), _tell_instance)
        tell(self, value)

    def tell_function(self, scope: Scope) -> None:
        """Puts into words what the inlining of a function sees of it."""
        text = function_text(scope.function, scope.text)
        if text is None:
            raise Untold
        self.words.append(text)
        for default in scope.function.__defaults__ or ():
            self._tell_default(default)

    def _tell_default(self, value: Any) -> None:
        """A default argument, whose value a kernel takes as it is."""
        if type(value) in _LITERALS:
            self.words.append(repr(value))
        elif type(value) in (tuple, list):
            self.words.append(f"{type(value).__name__} of {len(value)}")
            for element in value:
                self._tell_default(element)
        elif isinstance(value, np.ndarray | np.generic):
            array = cast("Any", value)
            self.words.append(f"{type(array).__name__} {array.dtype.str} {array.shape} {array.tobytes().hex()}")
        else:
            raise Untold

    def is_new(self, thing: Any) -> bool:
        """Gives ``thing`` a number; where it has one, tells that."""
        known = self._numbers.setdefault(id(thing), len(self.things))
        if known < len(self.things):
            self.words.append(f"#{known}")
            return False
        self.things.append(thing)
        return True


def function_text(function: FunctionType, text: str | None) -> str | None:
    """What tells a function as it is written from any other; None where nobody knows how it is written."""
    code = function.__code__
    key = text_key(function, text)
    if key is None:
        return None
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    return f"{key} {code.co_firstlineno} {code.co_name} {function.__name__} {names} {code.co_argcount} {code.co_flags}"


def named(value: Any) -> tuple[str, str]:
    """The module and the name by which other processes find a class or a function of Python or of a library.

    Raises:
        Untold: there is another thing of that name, or none.
    """
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", getattr(value, "__name__", None))
    if not isinstance(module, str) or not isinstance(name, str) or found(module, name) is not value:
        raise Untold
    return module, name


def found(module: str, name: str) -> Any:
    """What ``named`` names; None where there is nothing."""
    value: Any = sys.modules.get(module)
    for part in name.split("."):
        value = getattr(value, part, None)
    return value


# ---- What is told of each kind of thing ----


def _tell_type_of(world: World, value: Any) -> None:
    world.words.append(type(value).__name__)


def _tell_value(world: World, value: Any) -> None:
    world.words.append(repr(value))


def _tell_sized(world: World, value: Any) -> None:
    world.words.append(f"{type(value).__name__} of {len(value)}")


def _tell_array(world: World, value: Any) -> None:
    world.words.append(f"{type(value).__name__} {value.dtype.str} {value.shape}")


def _tell_named(world: World, value: Any) -> None:
    world.words.append(" ".join(named(value)))


def _tell_module(world: World, value: ModuleType) -> None:
    world.words.append(f"module {value.__name__}")


def _tell_builtin(world: World, value: Builtin | Form | Intrinsic) -> None:
    world.words.append(f"builtin {value.name}")


def _tell_type(world: World, value: ScalarType | VectorType | MatrixType) -> None:
    world.words.append(f"{type(value).__name__} {value.shape}")
    if isinstance(value, ScalarType):
        world.words.append(value.name)
    else:
        world.tell(value.scalar)


def _tell_key(world: World, value: KeyType) -> None:
    world.words.append("key")
    world.tell(value.target)


def _tell_relation(world: World, relation: Relation) -> None:
    """All that a kernel can tell of a relation. Of one that is no grid that is not how many rows it has."""
    if not world.is_new(relation):
        return
    shape = relation.shape if relation.is_grid else None
    kind = type(relation)
    world.words.append(
        f"{kind.__module__} {kind.__qualname__} {relation.name} {relation.key_dtype.str} {shape} {relation.periodic}"
    )
    attributes = relation._attributes  # pyright: ignore[reportPrivateUsage]
    world.words.append(str(len(attributes)))
    for name, value in sorted(attributes.items()):  # a kernel cannot tell in which order they were made
        match value:
            case Field():
                world.words.append(f"{name} {'grouped' if value.grouping is not None else 'field'}")
                world.tell(value.type)
            case Member():
                world.words.append(f"{name} member {_member_text(value)}")
            case Subset():
                world.words.append(f"{name} subset")


def _tell_attribute(world: World, value: Field | Member | Subset) -> None:
    """An attribute of a relation, by its name there."""
    if value.relation.attribute(value.name) is not value:
        raise Untold
    world.tell(value.relation)
    world.words.append(f"its {value.name}")


def _tell_global(world: World, value: Global) -> None:
    if world.is_new(value):
        world.words.append("global")
        world.tell(value.type)


def _tell_constant(world: World, value: Constant) -> None:
    world.words.append(f"constant {value.value!r}")
    world.tell(value.type)


def _tell_func(world: World, value: Func) -> None:
    if world.is_new(value):
        world.words.append(f"func {value.name}")
        world.tell_function(value.scope)


def _tell_python(world: World, value: FunctionType) -> None:
    """A function that is nothing in kernels, but may share its name with a local."""
    del value
    world.words.append("function")


def _tell_instance(world: World, value: Any) -> None:
    """An object of which a kernel sees the attributes that it asks for, which are steps of their own."""
    if isinstance(value, _MIMICS) or hasattr(value, "__ebb_type__"):
        raise Untold
    kind = cast("type[Any]", type(value))
    world.words.append(f"instance {kind.__module__} {kind.__qualname__}")


def _member_text(member: Member) -> str:
    """The functions of a member, as they are written."""
    found: list[str] = []
    for role, function in _roles(member).items():
        function = None if function is None else member_function(function)
        text = _texts.get(function) if isinstance(function, FunctionType) else None
        if text is None and isinstance(function, FunctionType):
            text = _texts[function] = function_text(function, None) or "unread"
        found.append(f"{role} {text}")
    return " ".join(found)


_texts: WeakKeyDictionary[FunctionType, str] = WeakKeyDictionary()

_LITERALS = frozenset((bool, int, float, str, type(None)))

_MIMICS = (int, float, str, tuple, list, dict, complex)
"""What is no such object but derived from one, and treated as such."""

_Tell: TypeAlias = "Callable[[World, Any], None]"

_TELL: Mapping[type[Any], _Tell] = {
    bool: _tell_type_of,
    int: _tell_type_of,
    float: _tell_type_of,
    str: _tell_value,
    type(None): _tell_value,
    tuple: _tell_sized,
    list: _tell_sized,
    dict: _tell_type_of,
    np.ndarray: _tell_array,
    Field: _tell_attribute,
    Member: _tell_attribute,
    Subset: _tell_attribute,
    Relation: _tell_relation,
    Global: _tell_global,
    Constant: _tell_constant,
    Func: _tell_func,
    FunctionType: _tell_python,
    Builtin: _tell_builtin,
    Form: _tell_builtin,
    Intrinsic: _tell_builtin,
    ModuleType: _tell_module,
    ScalarType: _tell_type,
    VectorType: _tell_type,
    MatrixType: _tell_type,
    KeyType: _tell_key,
}

_KINDS: tuple[tuple[type[Any], _Tell], ...] = (
    (Relation, _tell_relation),
    (ModuleType, _tell_module),
    (np.generic, _tell_array),
    (type, _tell_named),
    (BuiltinFunctionType, _tell_named),
)
