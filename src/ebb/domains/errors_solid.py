"""What can be wrong when a surface is filled with tetrahedra: the kinds of errors from E725 on."""

from __future__ import annotations

from typing import ClassVar

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.records import record


@record
class MissingTetgen(Diagnostic):
    """A conforming solid is wanted, and the package tetgen is not installed. Raised as a ``BackendError``."""

    code: ClassVar[str] = "E725"

    @property
    def title(self) -> str:
        return "a conforming solid needs the package tetgen, which is not installed"

    @property
    def hints(self) -> tuple[str, ...]:
        return ('pip install "ebblang[tetgen]"', "`method='lattice'` needs nothing, and its boundary has steps")


@record
class NotTetrahedralised(Diagnostic):
    """TetGen finds no solid in a surface. Raised as a ``MeshFormatError``."""

    code: ClassVar[str] = "E726"
    complaint: str

    @property
    def title(self) -> str:
        return f"the surface cannot be filled by TetGen: {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            "repair a surface that cuts itself, for example by `pymeshfix.MeshFix(points, triangles).repair()`",
            "`method='lattice'` takes any closed surface",
        )
