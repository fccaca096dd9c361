"""From the source of a kernel to KIR, in one walk: names, types, members, weak numbers and captured values at once."""

from __future__ import annotations

from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate.context import Context, Rules
from ebb.compiler.elaborate.errors import NoRowParameter
from ebb.compiler.elaborate.expressions import EXPRESSIONS
from ebb.compiler.elaborate.guards import Guard
from ebb.compiler.elaborate.inline import function_body, new_frame
from ebb.compiler.elaborate.parameters import FieldName, ParameterType, check_signature, name_span, positional
from ebb.compiler.elaborate.scope import Bound, Variable
from ebb.compiler.elaborate.source import SourceFunction
from ebb.compiler.elaborate.statements import STATEMENTS
from ebb.compiler.elaborate.trail import Trail
from ebb.compiler.elaborate.values import Static, Typed
from ebb.compiler.host import HostConst, HostParameter
from ebb.errors import KernelSyntaxError
from ebb.records import record, replace
from ebb.relations.relation import Relation


@record
class Elaborated:
    """A kernel in KIR, and what it assumes of the host: it is right as long as all guards hold.

    Attributes:
        trail: what was looked at.
    """

    kernel: kir.Kernel
    guards: tuple[Guard, ...]
    trail: Trail


def elaborate(
    source: SourceFunction,
    relation: Relation,
    parameters: tuple[ParameterType, ...] = (),
    arguments: tuple[Any, ...] = (),
) -> Elaborated:
    """The kernel ``source`` for the rows of ``relation``.

    Args:
        parameters: the types of the parameters after the row.
        arguments: their values at the launch that asks; they are looked at only where an error needs one.

    Raises:
        EbbError: everything that is wrong with the kernel, at once, as the kind of the first thing found.
    """
    check_signature(source)
    trail = Trail(source.function)
    source = replace(source, trail=trail)
    rows = positional(source.node)
    if not rows:
        raise KernelSyntaxError(NoRowParameter(name_span(source), source.name))
    row = kir.Local(rows[0].arg, 0, relation.key_type)
    frame = new_frame(source, source.name, None, None, kir.Label(source.name, 0))
    ctx = Context(Rules(EXPRESSIONS, STATEMENTS), source.name, relation, arguments, frame, trail)
    frame.bind(row.name, Variable(row, source.span(rows[0])))
    _bind_parameters(ctx, parameters)
    ctx.run(function_body(source.node))
    if ctx.found:
        diagnostics = [diagnostic for diagnostic, _ in ctx.found.values()]
        first = next(exception for _, exception in ctx.found.values())
        raise first(*diagnostics)
    span = name_span(source)
    body = tuple(ctx.out)
    if frame.returns.used:
        body = (kir.Block(frame.returns.label, body, span),)
    uniforms = tuple(value for _, value in ctx.uniforms.values())
    kernel = kir.Kernel(source.name, relation, row, uniforms, body, span)
    return Elaborated(kernel, tuple(ctx.guards.values()), trail)


def _bind_parameters(ctx: Context, parameters: tuple[ParameterType, ...]) -> None:
    frame = ctx.frame
    for position, (parameter, type_) in enumerate(zip(positional(frame.source.node)[1:], parameters, strict=True)):
        name, span = parameter.arg, frame.source.span(parameter)
        if isinstance(type_, FieldName):
            frame.bind(name, Bound(Static(type_.name, HostConst(type_.name), span), span))
            continue
        uniform = ctx.uniform(HostParameter(name, position), type_, span)
        if frame.once(name):
            frame.bind(name, Bound(Typed(uniform), span))
        else:
            local = ctx.new_local(name, type_)
            ctx.emit(kir.Assign(local, (), uniform, span))
            frame.bind(name, Variable(local, span))
