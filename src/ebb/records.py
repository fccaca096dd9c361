"""``@record`` makes the classes that hold facts: nodes, types, diagnostics; frozen, slotted and compared by value.

What ``@dataclass(frozen=True, slots=True)`` means, at a twentieth of its price. A dataclass compiles the source of six
methods, half a millisecond; the package has some three hundred such classes, and an import that takes a fifth of a
second is felt in every short program. Here only ``__init__`` needs code of its own, since it alone has the fields as
parameters, and that code stands here for each number of fields: a class takes a copy with its own names in it. The
other methods are shared. Making an object takes half the time too, because the slots are filled by
their descriptors without a look-up by name.

Type checkers know records as dataclasses (PEP 681), so ``match`` and exhaustiveness work on them. What they lack:
``__post_init__``, keyword-only and ``init=False`` fields, and ``super()`` without arguments in a method, since the
class is made anew to have slots (name the base instead). Annotations must be text, as the ``__future__`` import makes
them.
"""

# pyright: reportUnknownLambdaType=false
from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import cache, partial
from operator import attrgetter
from types import CellType, CodeType, FunctionType
from typing import Any, NoReturn, TypeVar, dataclass_transform, overload

__all__ = ["field", "record", "replace"]

T = TypeVar("T")


class _Absent(Enum):
    """What stands where no default is given."""

    ABSENT = "absent"


_ABSENT = _Absent.ABSENT


class _Field:
    """What a class says of one of its fields."""

    __slots__ = ("default", "factory", "shown")

    def __init__(self, default: Any, factory: Callable[[], Any] | None, shown: bool) -> None:
        self.default = default
        self.factory = factory
        self.shown = shown


_NONE: dict[str, _Field] = {}


@overload
def field(*, default: T, repr: bool = True) -> T: ...
@overload
def field(*, default_factory: Callable[[], T], repr: bool = True) -> T: ...
@overload
def field(*, repr: bool = True) -> Any: ...
def field(*, default: Any = _ABSENT, default_factory: Callable[[], Any] | None = None, repr: bool = True) -> Any:
    """Says more of a field than its type.

    Args:
        default: its value where none is given.
        default_factory: what makes its value where none is given, for each object anew.
        repr: whether ``repr`` of the object shows it.
    """
    return _Field(_ABSENT if default_factory else default, default_factory, repr)


@overload
def record(cls: type[T], /) -> type[T]: ...
@overload
def record(*, frozen: bool = True, eq: bool = True) -> Callable[[type[T]], type[T]]: ...
@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def record(cls: type[Any] | None = None, /, *, frozen: bool = True, eq: bool = True) -> Any:
    """Makes a class of the annotated names of ``cls``, in their order after those of its base.

    Args:
        cls: the class as it is written; with options, ``@record(...)``, it comes later.
        frozen: whether the fields of an object are fixed when it is made.
        eq: whether objects with equal fields are equal; else each is equal to itself alone.
    """
    if cls is None:
        return partial(_made, frozen=frozen, eq=eq)
    return _made(cls, frozen, eq)


def replace(original: T, /, **changes: Any) -> T:
    """A copy of the record ``original`` with other values for the named fields."""
    cls: Any = type(original)
    for name in cls.__match_args__:
        if name not in changes:
            changes[name] = getattr(original, name)
    return cls(**changes)


def _made(cls: type[Any], frozen: bool, eq: bool) -> type[Any]:
    namespace = dict(cls.__dict__)
    # What belongs to the class that is left behind: the new one has slots in their place.
    namespace.pop("__dict__", None)
    namespace.pop("__weakref__", None)
    own = tuple([name for name, text in cls.__annotations__.items() if not text.startswith("ClassVar")])
    said: dict[str, _Field] = getattr(cls, "__record_fields__", _NONE)
    for name in own:
        if name in namespace:
            default = namespace.pop(name)
            said = {**said, name: default if isinstance(default, _Field) else _Field(default, None, shown=True)}
    names: tuple[str, ...] = getattr(cls, "__match_args__", ()) + own
    namespace["__qualname__"] = cls.__qualname__
    namespace["__slots__"] = own
    namespace["__match_args__"] = names
    namespace["__record_fields__"] = said
    namespace["__reduce__"] = _reduce
    namespace.setdefault("__repr__", _represent)
    if frozen:
        namespace["__setattr__"] = namespace["__delattr__"] = _refuse_change
    if eq:
        namespace["__record_values__"] = attrgetter(*names) if names else _no_values
        namespace["__eq__"] = _equal
        namespace["__hash__"] = _hash if frozen else None
    metaclass: Any = type(cls)
    new: Any = metaclass(cls.__name__, cls.__bases__, namespace)
    new.__init__ = _initialiser(new, names, said)
    return new


# ---- __init__ ----

# fmt: off
_INITIALISERS: Any = (
    lambda: lambda self: None,
    lambda a: lambda self, _a: (a(self, _a)),
    lambda a, b: lambda self, _a, _b: (a(self, _a) or b(self, _b)),
    lambda a, b, c: lambda self, _a, _b, _c: (a(self, _a) or b(self, _b) or c(self, _c)),
    lambda a, b, c, d: lambda self, _a, _b, _c, _d: (a(self, _a) or b(self, _b) or c(self, _c) or d(self, _d)),
    lambda a, b, c, d, e: lambda self, _a, _b, _c, _d, _e: (a(self, _a) or b(self, _b) or c(self, _c) or d(self, _d)
        or e(self, _e)),
    lambda a, b, c, d, e, f: lambda self, _a, _b, _c, _d, _e, _f: (a(self, _a) or b(self, _b) or c(self, _c)
        or d(self, _d) or e(self, _e) or f(self, _f)),
    lambda a, b, c, d, e, f, g: lambda self, _a, _b, _c, _d, _e, _f, _g: (a(self, _a) or b(self, _b) or c(self, _c)
        or d(self, _d) or e(self, _e) or f(self, _f) or g(self, _g)),
    lambda a, b, c, d, e, f, g, h: lambda self, _a, _b, _c, _d, _e, _f, _g, _h: (a(self, _a) or b(self, _b)
        or c(self, _c) or d(self, _d) or e(self, _e) or f(self, _f) or g(self, _g) or h(self, _h)),
    lambda a, b, c, d, e, f, g, h, i: lambda self, _a, _b, _c, _d, _e, _f, _g, _h, _i: (a(self, _a) or b(self, _b)
        or c(self, _c) or d(self, _d) or e(self, _e) or f(self, _f) or g(self, _g) or h(self, _h) or i(self, _i)),
    lambda a, b, c, d, e, f, g, h, i, j: lambda self, _a, _b, _c, _d, _e, _f, _g, _h, _i, _j: (a(self, _a)
        or b(self, _b) or c(self, _c) or d(self, _d) or e(self, _e) or f(self, _f) or g(self, _g) or h(self, _h)
        or i(self, _i) or j(self, _j)),
    lambda a, b, c, d, e, f, g, h, i, j, k: lambda self, _a, _b, _c, _d, _e, _f, _g, _h, _i, _j, _k: (a(self, _a)
        or b(self, _b) or c(self, _c) or d(self, _d) or e(self, _e) or f(self, _f) or g(self, _g) or h(self, _h)
        or i(self, _i) or j(self, _j) or k(self, _k)),
    lambda a, b, c, d, e, f, g, h, i, j, k, m: lambda self, _a, _b, _c, _d, _e, _f, _g, _h, _i, _j, _k, _m: (a(self, _a)
        or b(self, _b) or c(self, _c) or d(self, _d) or e(self, _e) or f(self, _f) or g(self, _g) or h(self, _h)
        or i(self, _i) or j(self, _j) or k(self, _k) or m(self, _m)),
)
# fmt: on
"""For each usual number of fields, what takes their setters, which return None, and returns an ``__init__``. They stand
here so that Python keeps them compiled. Code holds what it closes over in the order of the alphabet."""


def _initialiser(cls: type[Any], names: tuple[str, ...], said: dict[str, _Field]) -> Callable[..., None]:
    code = _initialiser_code(len(names))
    made = FunctionType(
        code.replace(co_varnames=("self", *names), co_name="__init__", co_qualname=cls.__qualname__ + ".__init__"),
        globals(),
        "__init__",
        _defaults(cls, names, said) if said else (),
        tuple([CellType(getattr(cls, name).__set__) for name in names]),
    )
    factories = [(name, field.factory) for name, field in said.items() if field.factory is not None]
    return _filling(cls, made, factories) if factories else made


@cache
def _initialiser_code(count: int) -> CodeType:
    """The code of an ``__init__`` of that many fields, which closes over their setters."""
    setters = [f"set_{index:03}" for index in range(count)]
    if count < len(_INITIALISERS):
        return _INITIALISERS[count](*setters).__code__
    calls = " or ".join(f"{each}(self, _{each})" for each in setters)
    parameters = ", ".join(f"_{each}" for each in setters)
    code: CodeType = eval(f"lambda {', '.join(setters)}: lambda self, {parameters}: {calls}")(*setters).__code__
    return code


def _filling(
    cls: type[Any], initialise: Callable[..., None], factories: list[tuple[str, Callable[[], Any]]]
) -> Callable[..., None]:
    """An ``__init__`` that makes what was not given."""
    parts = [(getattr(cls, name).__get__, getattr(cls, name).__set__, make) for name, make in factories]

    def __init__(self: Any, *arguments: Any, **named: Any) -> None:  # noqa: N807
        initialise(self, *arguments, **named)
        for get, put, make in parts:
            if get(self) is _ABSENT:
                put(self, make())

    __init__.__wrapped__ = initialise  # pyright: ignore[reportFunctionMemberAccess] - for its signature
    return __init__


def _defaults(cls: type[Any], names: tuple[str, ...], said: dict[str, _Field]) -> tuple[Any, ...]:
    """The defaults of the last parameters, ``_ABSENT`` for those that are made by a factory."""
    found: list[Any] = []
    for name in names:
        field = said.get(name)
        if field is not None and (field.default is not _ABSENT or field.factory is not None):
            found.append(field.default)
        elif found:
            raise TypeError(f"a field without a default follows one with a default in {cls.__qualname__}")
    return tuple(found)


# ---- The other methods. Classes share them: what each function and closure of their own costs is looked at whenever
# Python collects garbage, and at its end. ----


def _no_values(self: Any) -> tuple[()]:
    del self
    return ()


def _equal(self: Any, other: object) -> bool:
    if other is self:
        return True
    cls = self.__class__
    if other.__class__ is not cls:
        return NotImplemented
    values = cls.__record_values__
    return values(self) == values(other)


def _hash(self: Any) -> int:
    return hash(self.__class__.__record_values__(self))


def _represent(self: Any) -> str:
    said: dict[str, _Field] = self.__record_fields__
    shown = [name for name in self.__match_args__ if name not in said or said[name].shown]
    return f"{type(self).__qualname__}({', '.join([f'{name}={getattr(self, name)!r}' for name in shown])})"


def _refuse_change(self: Any, name: str, value: Any = None) -> NoReturn:
    raise AttributeError(f"'{type(self).__name__}' is frozen: its '{name}' cannot be changed")


def _reduce(self: Any) -> tuple[Any, tuple[Any, ...]]:
    """How ``pickle`` and ``copy`` take the object apart: slots cannot be set in one that is frozen."""
    return self.__class__, tuple([getattr(self, name) for name in self.__match_args__])
