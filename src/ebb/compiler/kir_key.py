"""The text of all that the lowering of a kernel depends on, by which what became of it is found again.

Two kernels of one text lower to programs that differ in nothing but where failures stand in the source: the text leaves
out spans, and names fields, relations and globals by number, with what the lowering asks of each. It is no text to be
read: an expression that stands in several places is written once, and a node is its name and its parts, without
brackets, since each kind of node has a fixed number of them and each tuple says how long it is.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Callable, Iterable
from enum import Enum
from numbers import Rational
from operator import attrgetter
from typing import Any, TypeAlias

from ebb.compiler import kir
from ebb.compiler.phases.table import PhaseTable
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import Element, KeyType, MatrixType, ScalarType, VectorType

Named: TypeAlias = Field | Relation | Global


@record(eq=False)
class KernelKey:
    """The text of a kernel, and what it calls by number.

    Attributes:
        text: the same only for kernels that lower alike.
        named: fields, relations and globals, by their numbers.
    """

    text: str
    named: tuple[Named, ...]


def kernel_key(kernel: kir.Kernel, phases: PhaseTable, unchecked: Iterable[kir.Affine]) -> KernelKey:
    """The key of ``kernel`` with the ``phases`` and ``unchecked`` that the lowering takes with it."""
    writer = _Writer(frozenset(unchecked))
    writer.parts(kernel.name, kernel.relation, kernel.row)
    writer.parts(*[value.type for value in kernel.uniforms])
    for field, phase in phases.fields.items():
        flags = (phase.read, phase.written, phase.reduced, phase.centered_only, phase.queried)
        writer.parts(field, f"{phase.kind.name} {phase.op and phase.op.name} {flags}")
    for globl, phase in phases.globals.items():
        writer.parts(globl, f"{phase.kind.name} {phase.op and phase.op.name}")
    writer.parts(kernel.body)
    return KernelKey(" ".join(writer.words), tuple(writer.named))


class _Writer:
    """What is written so far, and what has a number."""

    def __init__(self, unchecked: frozenset[kir.Affine]) -> None:
        self.unchecked = unchecked
        self.words: list[str] = []
        self.named: dict[Named, str] = {}
        self.nodes: dict[int, str] = {}
        """By identity: the kernel holds them all while it is written."""

    def parts(self, *parts: Any) -> None:
        for part in parts:
            _WRITE.get(part.__class__, _write_other)(self, part)

    def name(self, thing: Named, *asked: Any) -> None:
        """Writes the number of ``thing``, and where it has none yet, what the lowering asks of it."""
        known = self.named.get(thing)
        if known is None:
            known = self.named[thing] = f"@{len(self.named)}"
            self.parts(*asked)
        self.words.append(known)


_Write: TypeAlias = Callable[[_Writer, Any], None]


# ---- Nodes ----


def _node_writer(node_type: type[Any]) -> _Write:
    """What writes nodes of ``node_type``: its name and all of their parts but the span."""
    names = [name for name in node_type.__match_args__ if name != "span"]
    tag, take = node_type.__name__, _taking(names)

    def write(writer: _Writer, node: Any) -> None:
        nodes = writer.nodes
        known = nodes.get(id(node))
        if known is not None:
            writer.words.append(known)
            return
        nodes[id(node)] = f"#{len(nodes)}"
        writer.words.append(tag)
        for part in take(node):
            _WRITE.get(part.__class__, _write_other)(writer, part)

    return write


def _taking(names: list[str]) -> Callable[[Any], tuple[Any, ...]]:
    """What takes the attributes ``names`` of an object."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda node: tuple([getattr(node, name) for name in names])


def _write_affine(writer: _Writer, node: kir.Affine) -> None:
    source = node.key.type.scalar
    assert isinstance(source, KeyType) and isinstance(source.target, Relation)
    # Where the launch has checked the access, no code does. A relation that is no grid has its size in the map, too.
    writer.parts(node in writer.unchecked, source.target.shape)
    _write_any_affine(writer, node)


_write_any_affine = _node_writer(kir.Affine)


# ---- What stands in nodes ----


def _write_tuple(writer: _Writer, parts: tuple[Any, ...]) -> None:
    writer.words.append(f"({len(parts)}")
    writer.parts(*parts)


def _write_literal(writer: _Writer, value: Any) -> None:
    writer.words.append(repr(value))


def _write_field(writer: _Writer, field: Field) -> None:
    writer.name(field, field.relation, field.name, field.type)


def _write_global(writer: _Writer, globl: Global) -> None:
    writer.name(globl, globl.type)


def _write_relation(writer: _Writer, relation: Relation) -> None:
    known = writer.named.get(relation)
    if known is not None:
        writer.words.append(known)
        return
    # How many rows there are does not matter but for grids: the same code serves meshes of all sizes.
    shape = relation.shape if relation.is_grid else relation.ndim
    writer.name(relation, relation.name, relation.key_dtype.str, relation.periodic, shape)


def _write_scalar(writer: _Writer, scalar: ScalarType) -> None:
    writer.words.append(scalar.name)


def _write_key(writer: _Writer, key: KeyType) -> None:
    writer.words.append("key")
    writer.parts(key.target)


def _write_vector(writer: _Writer, vector: VectorType) -> None:
    _write_elements(writer, f"vector {vector.n}", vector.scalar)


def _write_matrix(writer: _Writer, matrix: MatrixType) -> None:
    _write_elements(writer, f"matrix {matrix.rows} {matrix.cols}", matrix.scalar)


def _write_elements(writer: _Writer, shape: str, element: Element) -> None:
    if isinstance(element, ScalarType):
        writer.words.append(f"{shape} {element.name}")
    else:
        writer.words.append(shape)
        _write_key(writer, element)


def _write_local(writer: _Writer, local: kir.Local | kir.Label) -> None:
    known = writer.nodes.get(id(local))
    if known is None:
        known = writer.nodes[id(local)] = f"{local.name}:{local.uid}"
        if isinstance(local, kir.Local):
            writer.parts(local.type)
    writer.words.append(known)


def _write_other(writer: _Writer, part: Any) -> None:
    """What has types of its own: options, relations of domains, and numbers that are more than Python's."""
    match part:
        case Rational():  # also numbers of the user's that have names: what counts is their value
            writer.words.append(f"{int(part.numerator)}/{int(part.denominator)}")
        case Enum():
            writer.words.append(f"{type(part).__name__}.{part.name}")
        case Relation():
            _write_relation(writer, part)
        case float():
            writer.words.append(float.__repr__(part))
        case _:
            raise TypeError(f"{part!r} stands in no kernel")


_NODES: tuple[type[Any], ...] = (*typing.get_args(kir.Expr), *typing.get_args(kir.Stmt))

_LITERALS: tuple[type[Any], ...] = (str, int, float, bool, types.NoneType)

_WRITE: dict[type[Any], _Write] = {
    **{kind: _node_writer(kind) for kind in _NODES},
    **dict.fromkeys(_LITERALS, _write_literal),
    kir.Affine: _write_affine,
    kir.Local: _write_local,
    kir.Label: _write_local,
    tuple: _write_tuple,
    Field: _write_field,
    Global: _write_global,
    Relation: _write_relation,
    ScalarType: _write_scalar,
    KeyType: _write_key,
    VectorType: _write_vector,
    MatrixType: _write_matrix,
}
