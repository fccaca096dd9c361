"""The reference interpreter as a backend."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np

from ebb.backends.backend import CheckedKernel, How, Operation
from ebb.backends.reference.interpreter import run
from ebb.compiler import kir
from ebb.compiler.phases.table import PhaseTable
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import host_code_uses


@record(eq=False)
class ReferenceBound:
    """A kernel and the rows that it runs on; the interpreter looks everything else up as it goes."""

    kernel: kir.Kernel
    rows: RowSet

    def run(self, uniforms: Sequence[Any]) -> None:
        """Runs the kernel; raises as ``run``."""
        pairs = zip(self.kernel.uniforms, uniforms, strict=True)
        with np.errstate(over="ignore"):  # beyond its range float32 is infinite, as it is for literals
            values = tuple([uniform.type.dtype.type(v) if np.ndim(v) == 0 else v for uniform, v in pairs])
        run(self.kernel, self.rows, values)


@record(eq=False)
class ReferenceExecutable:
    """A kernel as the interpreter takes it, which is as it is."""

    kernel: kir.Kernel
    phases: PhaseTable

    def bind(self, rows: RowSet, changing: AbstractSet[Field] = frozenset()) -> ReferenceBound:
        """The kernel on ``rows``, whatever changes. What it writes is then no device's any more."""
        del changing
        fields, globals_ = self.phases.fields.items(), self.phases.globals.items()
        written = [field.buffer for field, phase in fields if phase.changed]
        written += [globl.buffer for globl, phase in globals_ if phase.reduced]
        host_code_uses(written, written)
        return ReferenceBound(self.kernel, rows)

    def how(self, rows: RowSet) -> How:
        """One row after the other."""
        del rows
        return How(
            reductions="into other rows: row after row in storage order",
            totals="row after row",
            order="one after the other, in storage order",
        )

    def inspect(self, stage: str) -> str | None:
        """None: there is no stage beyond KIR."""
        del stage
        return None


@record
class ReferenceBackend:
    """Runs kernels in plain Python. ``breakpoint()`` works in them."""

    name: str = "reference"
    stages: tuple[str, ...] = ()
    device: None = None
    facts_cache: None = None
    reorders: bool = False

    def prepare(self, checked: CheckedKernel) -> ReferenceExecutable:
        """The kernel is run as it is."""
        checked.verify()
        return ReferenceExecutable(checked.kernel, checked.phases)

    def replay(self, operations: Sequence[Operation]) -> None:
        """None: there is nothing but Python here."""
        del operations


def reference_backend() -> ReferenceBackend:
    """The reference backend, which has no options."""
    return ReferenceBackend()
