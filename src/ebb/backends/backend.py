"""What a backend is: it turns checked kernels into executables, and an executable runs on sets of rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from typing import Any, Protocol, TypeAlias

from ebb.backends.cache import ObjectCache
from ebb.compiler import kir
from ebb.compiler.phases.table import PhaseTable
from ebb.compiler.scatter.step import Step
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import Array
from ebb.runtime.device import Device

ANYWHERE = ("ptx", "spirv")
"""The stages that ``kernel.inspect`` shows on every backend: to emit them takes no device."""


@record
class Hints:
    """What ``@ebb.kernel(...)`` asks for. Hints change speed and rounding, never meaning.

    Attributes:
        block_size: rows a work-group on a GPU; cpu and reference have no use for it.
        fastmath: floats are taken for real numbers, but that NaN and infinity stay.
    """

    block_size: int = 64
    fastmath: bool = False


def _nothing_unverified() -> None:
    """For kernels that have been verified."""


@record(eq=False)
class CheckedKernel:
    """A kernel whose phases are right, after the passes.

    Attributes:
        step: the kernel, and what is known of it; perhaps it is made only when somebody asks for it.
        verify: verifies what the kernel was made of, unless that has been done; a backend calls it before it compiles
            or interprets the kernel.
    """

    step: Step
    hints: Hints
    verify: Callable[[], None] = _nothing_unverified

    @property
    def kernel(self) -> kir.Kernel:
        """The kernel."""
        return self.step.kernel

    @property
    def phases(self) -> PhaseTable:
        """The phases of its fields and globals."""
        return self.step.phases


@record
class How:
    """How a backend runs a kernel, in words, for ``kernel.explain``.

    Attributes:
        reductions: what is done with reductions into other rows.
        totals: what is done with reductions into globals.
        order: in which order the rows run.
    """

    reductions: str
    totals: str
    order: str


class Bound(Protocol):
    """A kernel on one set of rows, with all that stays as it is until the structure changes put in place."""

    def run(self, uniforms: Sequence[Any]) -> None:
        """Runs the kernel, or queues it on a device: who looks at data waits. The caller holds ``launching()``.

        Fields may have been swapped since the kernel was bound, and their values changed; nothing else.

        Args:
            uniforms: the values of ``kernel.uniforms``: for a scalar a Python or NumPy number of the kind of its type,
                a float perhaps with more digits than that has; for a vector or matrix an array.

        Raises:
            EbbError: an assertion or a bounds check of the kernel failed for some row.
        """
        ...


@record(eq=False)
class Once:
    """What is bound for one run only: before the next it is bound anew, whether or not the structure has changed."""

    bound: Bound

    def run(self, uniforms: Sequence[Any]) -> None:
        """Runs what is bound."""
        self.bound.run(uniforms)


@record(eq=False)
class RunKernel:
    """A captured launch: what is bound, and the values of its uniforms."""

    bound: Bound
    uniforms: tuple[Any, ...]


@record(eq=False)
class SwapFields:
    """Two fields of one relation and type exchange their values."""

    left: Field
    right: Field


@record(eq=False)
class SetGlobal:
    """A global gets a value, an array of its type and shape."""

    globl: Global
    value: Array


Operation: TypeAlias = RunKernel | SwapFields | SetGlobal
"""What a captured step consists of."""


class Replay(Protocol):
    """A captured step as a program."""

    def run(self, count: int) -> None:
        """Runs the step ``count`` times and waits for it. The caller holds ``launching()``.

        Raises:
            EbbError: an assertion or a check of a kernel failed for some row; what comes after it has not run.
        """
        ...


class Executable(Protocol):
    """A kernel made ready to run on one backend."""

    def bind(self, rows: RowSet, changing: AbstractSet[Field] = frozenset()) -> Bound:
        """The kernel on ``rows``, for the data as it is: good until ``structure_changed`` is next called, or ``Once``.

        Key fields on whose values it depends are ``followed`` then.

        The groupings that the kernel queries are valid. The caller holds ``launching()``.

        Args:
            rows: the kernel's relation or a subset of it.
            changing: key fields whose values may be others when the kernel runs; it queries none of them.

        Raises:
            BackendError: the kernel cannot be compiled.
        """
        ...

    def how(self, rows: RowSet) -> How:
        """How a launch on ``rows`` goes for the data as it is. As for ``bind``, groupings are valid."""
        ...

    def inspect(self, stage: str) -> str | None:
        """The text of a stage that this backend has beyond KIR, or None."""
        ...


class Backend(Protocol):
    """A way to run kernels, chosen by ``ebb.set_backend``."""

    @property
    def name(self) -> str:
        """What ``ebb.set_backend`` calls it."""
        ...

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages beyond KIR that its executables can show."""
        ...

    @property
    def device(self) -> Device | None:
        """The device that kernels run on, None where that is the processor."""
        ...

    @property
    def facts_cache(self) -> ObjectCache | None:
        """Where facts of kernels are kept between processes; None where launches take more than facts."""
        ...

    @property
    def reorders(self) -> bool:
        """Whether launches may permute relations so that kernels find rows closer together."""
        ...

    def prepare(self, checked: CheckedKernel) -> Executable:
        """Makes ``checked`` ready to run here; what can be compiled later may be."""
        ...

    def replay(self, operations: Sequence[Operation]) -> Replay | None:
        """Captured operations as a program that runs without Python, or None where there is no such thing here.

        Swapped fields have the same layout, and what is bound stays good while the program runs. It is good until
        ``structure_changed`` is next called.
        """
        ...
