"""Types of operands, conversions, literals and indices: E201 to E219."""

from __future__ import annotations

from typing import ClassVar

from ebb.compiler.elaborate.errors import KernelDiagnostic
from ebb.diagnostics.diagnostic import Label
from ebb.diagnostics.span import Span
from ebb.records import record
from ebb.types.rules import Mismatch, castable, is_number
from ebb.types.types import KeyType, ScalarType, Type, VectorType


def spelled(type_: Type) -> str:
    """A type as a program writes it, to be called as a cast."""
    if isinstance(type_, ScalarType):
        return f"ebb.{type_!r}"
    if isinstance(type_, KeyType):
        return type_.target.name
    kind = "vector" if isinstance(type_, VectorType) else "matrix"
    return f"ebb.{kind}({spelled(type_.scalar)}, {', '.join(map(str, type_.shape))})"


@record
class OperandTypes(KernelDiagnostic):
    """An operator does not take operands of these types."""

    code: ClassVar[str] = "E201"
    mismatch: Mismatch
    operands: tuple[tuple[Span, Type], ...]

    @property
    def title(self) -> str:
        return self.mismatch.text

    @property
    def secondary(self) -> tuple[Label, ...]:
        return tuple(Label(span, repr(type_)) for span, type_ in self.operands)

    @property
    def hints(self) -> tuple[str, ...]:
        return () if self.mismatch.hint is None else (self.mismatch.hint,)


@record
class NoCoercion(KernelDiagnostic):
    """A value is not of the type that its place has, and does not widen to it."""

    code: ClassVar[str] = "E202"
    source: Type
    target: Type
    place: str

    @property
    def title(self) -> str:
        return f"a value of type {self.source!r} does not become {self.target!r}, the type of {self.place}, by itself"

    @property
    def label(self) -> str:
        return repr(self.source)

    @property
    def notes(self) -> tuple[str, ...]:
        if self.source.shape != self.target.shape:
            return (f"their shapes are {self.source.shape} and {self.target.shape}",)
        if not (is_number(self.source) and is_number(self.target)):
            return ("bools, numbers and keys do not turn into each other",)
        return ("values widen by themselves: int32 to int64, integers to floats, float32 to float64",)

    @property
    def hints(self) -> tuple[str, ...]:
        if self.source.shape == self.target.shape and castable(self.source, self.target):
            return (f"cast it: {spelled(self.target)}(...)",)
        return ()


@record
class TypeChanged(KernelDiagnostic):
    """A local gets a value of another type than its first assignment gave it."""

    code: ClassVar[str] = "E203"
    name: str
    first: Type
    now: Type
    assigned: Span | None

    @property
    def title(self) -> str:
        now = f"a value of type {self.now!r}"
        return f"'{self.name}' is {self.first!r} since its first assignment, and {now} does not become one"

    @property
    def label(self) -> str:
        return repr(self.now)

    @property
    def secondary(self) -> tuple[Label, ...]:
        return () if self.assigned is None else (Label(self.assigned, f"makes it {self.first!r}"),)

    @property
    def hints(self) -> tuple[str, ...]:
        if self.first.shape == self.now.shape and is_number(self.first) and is_number(self.now):
            return (
                f"give '{self.name}' a first value of type {self.now!r}, such as {spelled(self.now)}(...)",
                f"or convert here: {spelled(self.first)}(...)",
            )
        return ("use another name for it",)


@record
class LiteralElements(KernelDiagnostic):
    """The elements of a literal make no vector or matrix."""

    code: ClassVar[str] = "E204"
    reason: str

    @property
    def title(self) -> str:
        return f"these elements make no vector or matrix: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("a vector has scalars of one type, a matrix rows of one length: [x, y, z], [[a, b], [c, d]]",)


@record
class IndexType(KernelDiagnostic):
    """An index is no integer."""

    code: ClassVar[str] = "E205"
    found: str

    @property
    def title(self) -> str:
        return f"an index is an integer, not {self.found}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("convert it: ebb.int32(i)",) if "float" in self.found else ()


@record
class IndexRange(KernelDiagnostic):
    """A constant index is beyond the end."""

    code: ClassVar[str] = "E206"
    index: int
    extent: int
    type: Type

    @property
    def title(self) -> str:
        return f"index {self.index} is out of range for {self.type!r}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"the indices of {self.extent} elements are 0 to {self.extent - 1}, or -{self.extent} to -1 from the end",
        )


@record
class NotIndexable(KernelDiagnostic):
    """Something without components is indexed, or by too many indices."""

    code: ClassVar[str] = "E207"
    what: str
    count: int
    advice: str | None = None

    @property
    def title(self) -> str:
        return f"{self.what} does not take {self.count} {'index' if self.count == 1 else 'indices'}"

    @property
    def hints(self) -> tuple[str, ...]:
        return () if self.advice is None else (self.advice,)


@record
class BadCast(KernelDiagnostic):
    """A cast between types that do not convert."""

    code: ClassVar[str] = "E208"
    target: Type
    reason: str

    @property
    def title(self) -> str:
        return f"{spelled(self.target)}(...) {self.reason}"


@record
class NotCompileTime(KernelDiagnostic):
    """Something must be known when the kernel is compiled, and is not."""

    code: ClassVar[str] = "E209"
    what: str

    @property
    def title(self) -> str:
        return f"{self.what} must be known when the kernel is compiled"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("known are literals, captured numbers, and the variable of a 'for' over a literal or captured tuple",)


@record
class NumberRange(KernelDiagnostic):
    """A Python number is not in the range of the type that its surroundings give it."""

    code: ClassVar[str] = "E210"
    value: str
    type: Type

    @property
    def title(self) -> str:
        return f"{self.value} is no {self.type!r}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("use a wider type",)


@record
class ConditionType(KernelDiagnostic):
    """A condition is not one bool."""

    code: ClassVar[str] = "E211"
    construct: str
    found: str
    hint: str | None

    @property
    def title(self) -> str:
        return f"'{self.construct}' takes a bool, not {self.found}"

    @property
    def label(self) -> str:
        return self.found

    @property
    def hints(self) -> tuple[str, ...]:
        return () if self.hint is None else (self.hint,)


@record
class DifferentTypes(KernelDiagnostic):
    """Values that must become one have no common type: the arms of a conditional, the returns of a function."""

    code: ClassVar[str] = "E212"
    what: str
    types: tuple[tuple[Span, str], ...]

    @property
    def title(self) -> str:
        return f"{self.what} have no common type: {' and '.join(dict.fromkeys(text for _, text in self.types))}"

    @property
    def secondary(self) -> tuple[Label, ...]:
        return tuple(Label(span, text) for span, text in self.types if span != self.span)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("cast one of them to the type of the other",)


@record
class ReductionTypes(KernelDiagnostic):
    """A reduction that is not defined on the type of its place."""

    code: ClassVar[str] = "E213"
    mismatch: Mismatch

    @property
    def title(self) -> str:
        return self.mismatch.text

    @property
    def notes(self) -> tuple[str, ...]:
        return ("fields and globals are reduced by + * min max on numbers, and by & | ^ on integers and bools",)

    @property
    def hints(self) -> tuple[str, ...]:
        return () if self.mismatch.hint is None else (self.mismatch.hint,)
