"""Where a compiled kernel can fail, and how the record of a failure becomes the user's error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from ebb.compiler import failures, kir
from ebb.diagnostics.span import Span
from ebb.errors import EbbError
from ebb.records import record
from ebb.relations.field import Field
from ebb.types.types import Type


@record
class AssertSite:
    stmt: kir.Assert


@record
class ComponentSite:
    """An index of a vector or matrix. Payload: the index."""

    span: Span
    axis: int
    type: Type


@record
class AffineSite:
    """An access to a row of a grid. Payload: the coordinates before they wrap."""

    node: kir.Affine | kir.RowAt


@record
class KeySite:
    """A key that may be unset. Payload: the position of the row whose key it is."""

    span: Span
    field: Field


@record
class StepSite:
    stmt: kir.ForRange


Site: TypeAlias = AssertSite | ComponentSite | AffineSite | KeySite | StepSite


def error_at(site: Site, kernel: kir.Kernel, position: int, payload: Sequence[int]) -> EbbError:
    """The error that the failure at ``site`` in the row at ``position`` is."""
    match site:
        case AssertSite(stmt):
            return failures.assertion_failed(kernel, position, stmt)
        case ComponentSite(span, axis, type_):
            return failures.component_out_of_range(kernel, position, span, payload[0], axis, type_)
        case AffineSite(node):
            return failures.affine_outside(kernel, position, node, payload)
        case KeySite(span, field):
            return failures.unset_key(kernel, position, span, field, payload[0])
        case StepSite(stmt):
            return failures.zero_step(kernel, position, stmt)
