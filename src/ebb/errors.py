"""The exceptions that Ebb raises. All of them carry diagnostics, and ``str(error)`` is their rendering.

EbbError
+-- KernelSyntaxError      Python that kernels do not have, or a kernel whose source cannot be found
+-- KernelTypeError        names, types, shapes and arguments that do not fit
+-- PhaseError             a field or global in two phases within one kernel
+-- RelationError          relations, fields, groupings, subsets and what is loaded into them
+-- BoundsError            an access outside a relation, a vector or a matrix
+-- KernelAssertionError   an ``assert`` in a kernel that did not hold
+-- BackendError           a device, driver or tool that is missing or lacks something
+-- MeshFormatError        a mesh file or mesh arrays that make no mesh
"""

from __future__ import annotations

import os
from typing import TypeVar

from ebb.diagnostics.diagnostic import Diagnostic

E = TypeVar("E", bound=BaseException)


def trimmed(error: E) -> E:
    """``error`` without the frames of the compiler, for ``raise trimmed(error) from None`` at the public surface.

    What is left of the traceback is the user's own frames, down to the call that failed. ``EBB_TRACEBACK=1`` in the
    environment keeps all frames.
    """
    return error if os.environ.get("EBB_TRACEBACK") == "1" else error.with_traceback(None)


class EbbError(Exception):
    """The base of every error that Ebb raises on purpose.

    Args:
        diagnostics: what is wrong, one or more; each has a code that ``ebb explain`` knows.
    """

    def __init__(self, *diagnostics: Diagnostic) -> None:
        super().__init__(*diagnostics)
        self.diagnostics: tuple[Diagnostic, ...] = diagnostics

    @property
    def codes(self) -> tuple[str, ...]:
        """The codes of the diagnostics, in their order."""
        return tuple(diagnostic.code for diagnostic in self.diagnostics)

    def __str__(self) -> str:
        from ebb.diagnostics.render import render_all  # here: programs without errors do not wait for it

        return render_all(self.diagnostics)


class KernelSyntaxError(EbbError):
    """Python that kernels do not have, or a kernel whose source cannot be found."""


class KernelTypeError(EbbError):
    """Names, types, shapes or arguments that do not fit."""


class PhaseError(EbbError):
    """A field or a global is in two phases within one kernel (paper, section 3.1)."""


class RelationError(EbbError):
    """A relation, field, grouping or subset is used, or data is loaded into it, in a way that it does not allow."""


class BoundsError(EbbError):
    """An access falls outside a relation, a vector or a matrix."""


class KernelAssertionError(EbbError):
    """An ``assert`` in a kernel did not hold for some row."""


class BackendError(EbbError):
    """A device, driver or tool is missing, or lacks what the kernel needs."""


class MeshFormatError(EbbError):
    """A mesh file or the arrays of a mesh make no mesh."""
