"""Calls, loops and what they range over: E220 to E239."""

from __future__ import annotations

from typing import ClassVar

from ebb.compiler.elaborate.errors import KernelDiagnostic
from ebb.compiler.elaborate.errors_names import did_you_mean
from ebb.records import record


@record
class BuiltinArguments(KernelDiagnostic):
    """A builtin does not take these arguments."""

    code: ClassVar[str] = "E220"
    name: str
    complaint: str
    advice: str | None

    @property
    def title(self) -> str:
        return f"'{self.name}' {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return () if self.advice is None else (self.advice,)


@record
class CallArguments(KernelDiagnostic):
    """A func or member does not take these arguments."""

    code: ClassVar[str] = "E221"
    name: str
    complaint: str
    signature: str
    parameters: tuple[str, ...]
    unknown: str | None = None

    @property
    def title(self) -> str:
        return f"'{self.name}' {self.complaint}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"its definition is {self.signature}",)

    @property
    def hints(self) -> tuple[str, ...]:
        return () if self.unknown is None else did_you_mean(self.unknown, self.parameters)


@record
class NoValue(KernelDiagnostic):
    """The result of a function that returns nothing is used."""

    code: ClassVar[str] = "E222"
    function: str

    @property
    def title(self) -> str:
        return f"'{self.function}' returns nothing, and its value is used"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("call it in a statement of its own, or return a value from it",)


@record
class MayEndWithoutValue(KernelDiagnostic):
    """A function returns a value on some ways and ends without one on others."""

    code: ClassVar[str] = "E223"
    function: str

    @property
    def title(self) -> str:
        return f"'{self.function}' returns a value on some ways and none on others"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("end every way with 'return value'",)


@record
class NotIterable(KernelDiagnostic):
    """A ``for`` over something that kernels do not loop over."""

    code: ClassVar[str] = "E224"
    what: str
    advice: str

    @property
    def title(self) -> str:
        return f"a 'for' in a kernel does not run over {self.what}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.advice,)


@record
class UnpackCount(KernelDiagnostic):
    """The numbers of names and of values differ."""

    code: ClassVar[str] = "E225"
    names: int
    values: str

    @property
    def title(self) -> str:
        return f"{self.values} cannot be unpacked into {self.names} name{'' if self.names == 1 else 's'}"


@record
class NotGrouped(KernelDiagnostic):
    """``ebb.where`` on a field that is not grouped."""

    code: ClassVar[str] = "E226"
    field: str
    relation: str
    name: str

    @property
    def title(self) -> str:
        return f"'{self.relation}' is not grouped by '{self.name}'"

    @property
    def label(self) -> str:
        return f"finds rows by '{self.field}'"

    @property
    def hints(self) -> tuple[str, ...]:
        return (f'before the launch: {self.relation}.group_by("{self.name}")',)


@record
class WhereArguments(KernelDiagnostic):
    """The arguments of ``ebb.where`` are no key field and key."""

    code: ClassVar[str] = "E227"
    complaint: str

    @property
    def title(self) -> str:
        return f"'ebb.where' {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("ebb.where(edges.tail, v): the rows of 'edges' whose 'tail' is v",)


@record
class AffineArguments(KernelDiagnostic):
    """The arguments of ``ebb.affine`` do not fit."""

    code: ClassVar[str] = "E228"
    complaint: str

    @property
    def title(self) -> str:
        return f"'ebb.affine' {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c): a row of factors and an offset for each dimension",)


@record
class RowAtArguments(KernelDiagnostic):
    """The arguments of ``ebb.row_at`` do not fit."""

    code: ClassVar[str] = "E233"
    complaint: str

    @property
    def title(self) -> str:
        return f"'ebb.row_at' {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("ebb.row_at(cells, [i, j]): a grid, and an index for each dimension",)


@record
class KeyArgument(KernelDiagnostic):
    """``ebb.id`` or ``ebb.coords`` of something else than a key (of a grid)."""

    code: ClassVar[str] = "E229"
    function: str
    expected: str
    found: str

    @property
    def title(self) -> str:
        return f"'ebb.{self.function}' takes {self.expected}, not {self.found}"


@record
class NoSetter(KernelDiagnostic):
    """A member is changed in a way that it has no function for."""

    code: ClassVar[str] = "E230"
    member: str
    relation: str
    op: str | None

    @property
    def title(self) -> str:
        how = "assigned: it has no setter" if self.op is None else f"reduced by '{self.op}': it has no such reducer"
        return f"the member '{self.member}' of '{self.relation}' cannot be {how}"

    @property
    def hints(self) -> tuple[str, ...]:
        decorator = "setter" if self.op is None else f'reducer("{self.op}")'
        return (f"define one: @{self.relation}.{self.member}.{decorator}, a function of the key and the value",)


@record
class RandomType(KernelDiagnostic):
    """``ebb.rand`` of something else than a float type."""

    code: ClassVar[str] = "E231"
    function: str

    @property
    def title(self) -> str:
        return f"'ebb.{self.function}' takes nothing, ebb.float32 or ebb.float64"


@record
class RangeArguments(KernelDiagnostic):
    """The arguments of ``range`` are no one to three integers."""

    code: ClassVar[str] = "E232"
    complaint: str

    @property
    def title(self) -> str:
        return f"'range' takes one to three integers, not {self.complaint}"
