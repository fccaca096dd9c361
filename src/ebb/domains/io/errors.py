"""What can be wrong with a mesh or its file: the kinds of ``MeshFormatError`` (E7xx)."""

from __future__ import annotations

from math import isfinite
from typing import ClassVar

from ebb.diagnostics.diagnostic import Diagnostic, Label
from ebb.diagnostics.span import Span
from ebb.domains.io.data import Origin
from ebb.records import record

_ANYHOW = "repair the mesh, for example with pymeshfix, or pass `manifold=False` to take it as it is"


@record
class UnreadableFile(Diagnostic):
    """The file is missing, a directory, or may not be read or written."""

    code: ClassVar[str] = "E701"
    path: str
    reason: str

    @property
    def title(self) -> str:
        return f"the mesh file {self.path!r} cannot be opened: {self.reason}"


@record
class UnknownFormat(Diagnostic):
    """No reader or writer takes the file, or it holds no cells, or no points, of the kind that is asked for."""

    code: ClassVar[str] = "E702"
    path: str
    reason: str
    what: str = "mesh"

    @property
    def title(self) -> str:
        return f"{self.path!r} holds no {self.what} that can be used here: {self.reason}"

    @property
    def hints(self) -> tuple[str, ...]:
        if self.what == "points":
            return ("archives (.npz) have positions as their array 'pos'; for the other formats, see `meshio --help`",)
        return ("OFF and VEG are read natively; for the other formats, see `meshio --help`",)


@record
class MalformedLine(Diagnostic):
    """A line is not what the format has at this place."""

    code: ClassVar[str] = "E703"
    span: Span
    expected: str

    @property
    def title(self) -> str:
        return f"{_place(self.span)}: expected {self.expected}"

    @property
    def primary(self) -> Label | None:
        return Label(self.span, f"expected {self.expected}")


@record
class TruncatedFile(Diagnostic):
    """The file ends before everything that its counts announce."""

    code: ClassVar[str] = "E704"
    span: Span
    what: str
    announced: int
    found: int

    @property
    def title(self) -> str:
        return f"{_place(self.span)}: {self.announced} {self.what} are announced, but only {self.found} follow"

    @property
    def primary(self) -> Label | None:
        return Label(self.span, "the last line of what there is")

    @property
    def notes(self) -> tuple[str, ...]:
        return ("the file is cut short, or its counts are wrong",)


@record
class BadElement(Diagnostic):
    """The base of the errors that name one row of the points or cells, and its line where there is one."""

    kind: str
    row: int
    origin: Origin | None

    @property
    def span(self) -> Span | None:
        if self.origin is None:
            return None
        return self.origin.point(self.row) if self.kind == "point" else self.origin.cell(self.row)

    @property
    def complaint(self) -> str:
        """What is wrong with it, as the end of a sentence that begins with it."""
        raise NotImplementedError(f"{type(self).__name__} has no complaint")

    @property
    def title(self) -> str:
        span = self.span
        if span is not None:
            return f"{_place(span)}: {self.kind} {self.row} {self.complaint}"
        where = "" if self.origin is None else f"{self.origin.source.filename}: "
        return f"{where}{self.kind} {self.row} {self.complaint}"

    @property
    def primary(self) -> Label | None:
        span = self.span
        return None if span is None else Label(span, self.complaint)


@record
class IndexOutOfRange(BadElement):
    """A cell has a corner that is no point, or a polyhedron a face that is none."""

    code: ClassVar[str] = "E705"
    index: int
    size: int
    base: int = 0
    part: str = "corner"
    target: str = "points"

    @property
    def complaint(self) -> str:
        last = self.size - 1 + self.base
        known = f"the {self.target} are numbered from {self.base} to {last}"
        return f"has the {self.part} {self.index}, but {known if self.size else f'there are no {self.target}'}"


@record
class NotFinite(BadElement):
    """A coordinate is NaN or infinite, or beyond the range of float32."""

    code: ClassVar[str] = "E706"
    coordinates: tuple[float, ...]

    @property
    def complaint(self) -> str:
        beyond = all(map(isfinite, self.coordinates))
        return f"has a coordinate that is {'too large for float32' if beyond else 'not finite'}: {self.coordinates}"


@record
class DegenerateElement(BadElement):
    """A cell has no area or no volume."""

    code: ClassVar[str] = "E707"
    corners: tuple[int, ...]
    measure: str
    count: int = 1
    total: int = 1

    @property
    def complaint(self) -> str:
        repeated = len(set(self.corners)) < len(self.corners)
        reason = "it names one point twice" if repeated else "its points lie in a line or a plane"
        return f"with the corners {self.corners} has no {self.measure}: {reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"{self.count} of the {self.total} elements are degenerate",) if self.count > 1 else ()


@record
class InvertedElement(BadElement):
    """A tetrahedron or hexahedron has its corners in the order that gives a negative volume."""

    code: ClassVar[str] = "E708"
    corners: tuple[int, ...]
    volume: float
    count: int
    total: int

    @property
    def complaint(self) -> str:
        return f"with the corners {self.corners} is inverted: its volume is {self.volume:.3g}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"{self.count} of the {self.total} elements are inverted",)

    @property
    def hints(self) -> tuple[str, ...]:
        turned = "the lower and the upper face" if len(self.corners) == 8 else "two corners"
        return (f"pass `fix_orientation=True` to exchange {turned} of each inverted element",)


@record
class RepeatedElement(BadElement):
    """Two elements have the same corners: what is summed over elements would count them twice."""

    code: ClassVar[str] = "E719"
    corners: tuple[int, ...]
    other: int

    @property
    def complaint(self) -> str:
        return f"with the corners {self.corners} is the {self.kind} {self.other} once more"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("keep `cells[np.unique(np.sort(cells, axis=1), axis=0, return_index=True)[1]]`",)


@record
class NonManifold(BadElement):
    """More cells meet at an edge or a face than a surface or a solid can have there."""

    code: ClassVar[str] = "E709"
    shared: tuple[int, ...]
    count: int
    limit: str

    @property
    def complaint(self) -> str:
        what = "edge" if len(self.shared) == 2 else "face"
        return f"is one of {self.count} at the {what} of the points {self.shared}, where {self.limit} may meet"

    @property
    def hints(self) -> tuple[str, ...]:
        return (_ANYHOW,) if self.kind in ("triangle", "face") else ()


@record
class InconsistentOrientation(BadElement):
    """Two neighbouring faces have their corners in opposite senses, or one occurs twice."""

    code: ClassVar[str] = "E710"
    other: int
    edge: tuple[int, int]

    @property
    def complaint(self) -> str:
        return f"and {self.kind} {self.other} both run along the edge of the points {self.edge} in the same direction"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"the {self.kind}s of a surface all turn the same way, so that neighbours run along their edge oppositely",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return (_ANYHOW,)


@record
class OpenSurface(Diagnostic):
    """A surface that should enclose a volume has a boundary."""

    code: ClassVar[str] = "E711"
    edges: int
    first: tuple[int, int]

    @property
    def title(self) -> str:
        return f"the surface is not closed: {self.edges} edges, the first of the points {self.first}, have one triangle"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("close it first, for example with `pymeshfix.MeshFix(points, triangles).repair()`",)


@record
class WrongArray(Diagnostic):
    """An array of points or cells has the wrong shape or kind of numbers."""

    code: ClassVar[str] = "E712"
    name: str
    expected: str
    found: str

    @property
    def title(self) -> str:
        return f"{self.name} should be {self.expected}, not {self.found}"


@record
class MissingMeshio(Diagnostic):
    """The format is one of meshio's, and meshio is not installed. Raised as a ``BackendError``."""

    code: ClassVar[str] = "E713"
    path: str

    @property
    def title(self) -> str:
        return f"{self.path!r} needs the package meshio, which is not installed"

    @property
    def hints(self) -> tuple[str, ...]:
        return ('pip install "ebblang[mesh]"',)


@record
class Unsavable(Diagnostic):
    """The file format, or a mesh, has no place for a field that is to be saved."""

    code: ClassVar[str] = "E714"
    path: str
    reason: str

    @property
    def title(self) -> str:
        return f"cannot save {self.path!r}: {self.reason}"


@record
class FoldedElement(BadElement):
    """At some corners of a hexahedron, but not at all, the three edges lie in a plane or turn the wrong way."""

    code: ClassVar[str] = "E715"
    corners: tuple[int, ...]
    bad: tuple[int, ...]
    count: int
    total: int

    @property
    def complaint(self) -> str:
        at = "the point" if len(self.bad) == 1 else "the points"
        points = ", ".join(map(str, self.bad))
        return f"with the corners {self.corners} is folded at {at} {points}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"{self.count} of the {self.total} elements are folded",
            "the three edges at each corner should be right-handed; corners go around the lower face, then the upper",
        )


@record
class OpenCell(BadElement):
    """The faces of a polyhedron do not enclose it: they leave a hole, or meet where they should not."""

    code: ClassVar[str] = "E716"
    reason: str

    @property
    def complaint(self) -> str:
        return f"is no polyhedron: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("at each edge of a polyhedron two of its faces meet",)


@record
class OverlappingCells(BadElement):
    """Two polyhedra lie on the same side of a face that they share."""

    code: ClassVar[str] = "E717"
    other: int
    face: int

    @property
    def complaint(self) -> str:
        return f"and cell {self.other} lie on the same side of face {self.face}, which they share"


@record
class TooFewParts(BadElement):
    """A polygon has fewer than three corners, a polyhedron fewer than four faces, or one of them twice."""

    code: ClassVar[str] = "E718"
    reason: str

    @property
    def complaint(self) -> str:
        return self.reason


def _place(span: Span) -> str:
    return f"{span.source.filename}, line {span.line}"
