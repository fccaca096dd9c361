"""The reference interpreter as a backend."""

from __future__ import annotations

from typing import Any

from ebb.backends.backend import CheckedKernel
from ebb.backends.reference.interpreter import run
from ebb.compiler import kir
from ebb.records import record
from ebb.relations.subset import RowSet


@record(eq=False)
class ReferenceBound:
    """A kernel and the rows that it runs on; the interpreter looks everything else up as it goes."""

    kernel: kir.Kernel
    rows: RowSet

    def run(self, uniforms: tuple[Any, ...]) -> None:
        """Runs the kernel; raises as ``run``."""
        run(self.kernel, self.rows, uniforms)


@record(eq=False)
class ReferenceExecutable:
    """A kernel as the interpreter takes it, which is as it is."""

    kernel: kir.Kernel

    def bind(self, rows: RowSet) -> ReferenceBound:
        """The kernel on ``rows``."""
        return ReferenceBound(self.kernel, rows)

    def inspect(self, stage: str) -> str | None:
        """None: there is no stage beyond KIR."""
        del stage
        return None


@record
class ReferenceBackend:
    """Runs kernels in plain Python. ``breakpoint()`` works in them."""

    name: str = "reference"
    stages: tuple[str, ...] = ()

    def prepare(self, checked: CheckedKernel) -> ReferenceExecutable:
        """The kernel is run as it is."""
        return ReferenceExecutable(checked.kernel)


def reference_backend() -> ReferenceBackend:
    """The reference backend, which has no options."""
    return ReferenceBackend()
