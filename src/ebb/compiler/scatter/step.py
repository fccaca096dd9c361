"""A step of a launch: one kernel of those that run one after the other in the place of the one that was written."""

from __future__ import annotations

from collections.abc import Callable

from ebb.compiler import kir
from ebb.compiler.cost import Cost, cost_of
from ebb.compiler.outline import Outline, group_of, outline_of
from ebb.compiler.phases.table import PhaseTable


class Step:
    """A kernel, and what the lowering knows of it.

    Attributes:
        phases: of its fields and globals.
    """

    __slots__ = ("_kernel", "_outline", "_unchecked", "phases")

    def __init__(self, kernel: kir.Kernel, phases: PhaseTable, unchecked: tuple[kir.Affine, ...]) -> None:
        """The step that runs ``kernel``, whose accesses ``unchecked`` are known to stay within their grids."""
        self._kernel = kernel
        self._unchecked = unchecked
        self._outline: Outline | None = None
        self.phases = phases

    @property
    def kernel(self) -> kir.Kernel:
        """The kernel."""
        return self._kernel

    @property
    def unchecked(self) -> tuple[kir.Affine, ...]:
        """Its affine accesses that are known to stay within their grids."""
        return self._unchecked

    @property
    def outline(self) -> Outline:
        """What is asked of the kernel before it is lowered."""
        if self._outline is None:
            self._outline = outline_of(self.kernel, self.phases, self.unchecked)
        return self._outline

    def cost(self) -> Cost:
        """The cost of a row on the data that the relations hold now."""
        outline = self._outline  # not made for this: most steps whose cost is asked are weighed and not taken
        if outline is not None and all([group_of(each.index) == each for each in outline.groups]):
            return outline.cost
        return cost_of(self.kernel)


class OutlinedStep(Step):
    """A step of which the outline is known, and the kernel is made when somebody asks for it."""

    __slots__ = ("_made", "_make")

    def __init__(self, outline: Outline, phases: PhaseTable, make: Callable[[], Step]) -> None:  # pyright: ignore[reportMissingSuperCall]
        self._outline = outline
        self._make = make
        self._made: Step | None = None
        self.phases = phases

    @property
    def kernel(self) -> kir.Kernel:
        """The kernel."""
        return self._step().kernel

    @property
    def unchecked(self) -> tuple[kir.Affine, ...]:
        """Its affine accesses that are known to stay within their grids."""
        return self._step().unchecked

    def _step(self) -> Step:
        if self._made is None:
            self._made = self._make()
        return self._made
