"""The state of one elaboration: what has been emitted, what has been captured, what is wrong."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from typing import Any, cast

import numpy as np

from ebb.compiler import kir
from ebb.compiler.elaborate.errors import KernelDiagnostic
from ebb.compiler.elaborate.errors_names import CaptureFailed
from ebb.compiler.elaborate.errors_syntax import RejectedSyntax
from ebb.compiler.elaborate.guards import (
    ArrayGuard,
    Guard,
    IdentityGuard,
    RangeGuard,
    StructureGuard,
    TypeGuard,
    ValueGuard,
    host_identity,
    reader,
    structure_of,
)
from ebb.compiler.elaborate.rejected import REJECTED_EXPRESSIONS, REJECTED_STATEMENTS
from ebb.compiler.elaborate.scope import Frame
from ebb.compiler.elaborate.source import Located
from ebb.compiler.elaborate.trail import Trail
from ebb.compiler.elaborate.values import BoundMember, Poison, Query, Typed, Value, WeakChoice
from ebb.compiler.elaborate.values import Sequence as SequenceValue
from ebb.compiler.host import (
    HostAttribute,
    HostConst,
    HostExpr,
    HostItem,
    HostParameter,
    HostValue,
    describe,
    evaluate,
)
from ebb.compiler.kir_walk import children
from ebb.diagnostics.diagnostic import Diagnostic
from ebb.diagnostics.span import Span
from ebb.errors import EbbError
from ebb.records import record, replace
from ebb.relations.relation import Relation
from ebb.types.types import ScalarType, Type

#: A comment at the end of a line; one with quotes in it may be part of a string.
_COMMENT = re.compile(r"\s+#[^'\"]*$")


@record
class Rules:
    """How each kind of Python node is elaborated."""

    expressions: Mapping[type[ast.expr], Callable[[Context, Any], Value]]
    statements: Mapping[type[ast.stmt], Callable[[Context, Any], None]]


class Context:
    """One elaboration of one kernel.

    Attributes:
        frame: the function whose statements are being elaborated.
        out: where statements go now.
        arguments: the values of the further parameters at the launch that asks.
        trail: what has been looked at.
    """

    def __init__(
        self, rules: Rules, name: str, relation: Relation, arguments: tuple[Any, ...], frame: Frame, trail: Trail
    ) -> None:  # fmt: skip
        self.kernel = name
        self.relation = relation
        self.frame = frame
        self.out: list[kir.Stmt] = []
        self.arguments = arguments
        self.found: dict[Any, tuple[Diagnostic, type[EbbError]]] = {}
        self.uniforms: dict[Any, tuple[int, HostValue]] = {}
        self.guards: dict[Any, Guard] = {}
        self._rules = rules
        self._uid = 0
        self._depth = 0
        self._returns = frame.returns
        self.trail = trail

    # Python nodes

    def value(self, node: ast.expr) -> Value:
        """What an expression denotes. Statements that it needs are emitted before."""
        rule = self._rules.expressions.get(type(node))
        if rule is not None:
            return rule(self, node)
        construct, alternative = REJECTED_EXPRESSIONS[type(node)]
        return self.poison(RejectedSyntax(self.span(node), construct, alternative))

    def values(self, nodes: Sequence[ast.expr]) -> list[Value]:
        """What several expressions denote, evaluated from left to right."""
        done: list[Value] = []
        for node in nodes:
            mark = len(self.out)
            value = self.value(node)
            if done and len(self.out) != mark:
                done = self.keep(mark, done)
            done.append(value)
        return done

    def run(self, statements: Sequence[ast.stmt]) -> None:
        """Elaborates statements."""
        for statement in statements:
            rule = self._rules.statements.get(type(statement))
            if rule is not None:
                rule(self, statement)
            else:
                construct, alternative = REJECTED_STATEMENTS[type(statement)]
                self.report(RejectedSyntax(self.opening(statement), construct, alternative))

    def span(self, node: Located) -> Span:
        return self.frame.source.span(node, self.frame.call)

    def opening(self, node: ast.stmt) -> Span:
        """The first line of a statement, for what concerns the statement as a whole."""
        span = self.span(node)
        if span.end_line == span.line:
            return span
        line = _COMMENT.sub("", span.source.line(span.line).rstrip())
        return replace(span, end_line=span.line, end_column=len(line))

    # Errors

    def report(self, diagnostic: Diagnostic, exception: type[EbbError] | None = None) -> None:
        """Keeps an error. The same one from another inlining of the same code is kept once."""
        if exception is None:
            assert isinstance(diagnostic, KernelDiagnostic)
            exception = diagnostic.exception
        place = None if diagnostic.primary is None else replace(diagnostic.primary.span, caller=None)
        self.found.setdefault((type(diagnostic), place, diagnostic.title), (diagnostic, exception))

    def poison(self, diagnostic: KernelDiagnostic) -> Poison:
        """Keeps an error, and gives the value of what is wrong."""
        self.report(diagnostic)
        return Poison(diagnostic.span)

    # Statements

    def emit(self, statement: kir.Stmt) -> None:
        self.out.append(statement)

    @contextmanager
    def nested(self) -> Generator[list[kir.Stmt]]:
        """Statements emitted inside go to the list that this gives."""
        outer, self.out = self.out, []
        self._depth += 1
        try:
            yield self.out
        finally:
            self.out = outer
            self._depth -= 1

    @property
    def surely_runs(self) -> bool:
        """Whether every row comes to what is being elaborated: it is in no branch, and after no ``return``."""
        return self._depth == 0 and not self._returns.used

    def new_local(self, name: str, type_: Type) -> kir.Local:
        self._uid += 1
        return kir.Local(name, self._uid, type_)

    def new_label(self, name: str) -> kir.Label:
        self._uid += 1
        return kir.Label(name, self._uid)

    def temporary(self, name: str, expr: kir.Expr) -> kir.ReadLocal:
        """``expr`` in a new local, evaluated here."""
        local = self.new_local(name, expr.type)
        self.emit(kir.Assign(local, (), expr, expr.span))
        return kir.ReadLocal(local, expr.type, expr.span)

    def simple(self, expr: kir.Expr) -> kir.Expr:
        """``expr`` so that it can be repeated at no cost: itself if it is a constant or local, else in a new local."""
        return expr if is_simple(expr) else self.temporary("value", expr)

    def keep(self, mark: int, values: list[Value]) -> list[Value]:
        """``values``, computed before the statements that were emitted since ``mark``.

        Whatever reads fields or globals is put into locals there, because those statements may change them.
        """
        if len(self.out) == mark or not values:
            return values
        later, self.out[mark:] = self.out[mark:], []
        kept = [self._kept(value) for value in values]
        self.out += later
        return kept

    def keep_exprs(self, mark: int, exprs: tuple[kir.Expr, ...]) -> tuple[kir.Expr, ...]:
        """``keep`` for expressions."""
        kept = self.keep(mark, [Typed(expr) for expr in exprs])
        return tuple(value.expr for value in kept if isinstance(value, Typed))

    def _kept(self, value: Value) -> Value:
        match value:
            case Typed(expr):
                return value if is_stable(expr) else Typed(self.temporary("value", expr))
            case WeakChoice(condition):
                return value if is_stable(condition) else replace(value, condition=self.temporary("value", condition))
            case SequenceValue(elements):
                return replace(value, elements=tuple(self._kept(element) for element in elements))
            case Query(_, key) | BoundMember(_, key):
                return value if is_stable(key) else replace(value, key=self.temporary("key", key))
            case _:
                return value

    # Captured values

    def evaluate(self, host: HostExpr, span: Span) -> tuple[bool, Any]:
        """Whether ``host`` has a value now, and which. Where it has none, the error is reported."""
        try:
            return True, evaluate(host, self.arguments)
        except Exception as error:  # whatever the user's own objects raise
            self.report(CaptureFailed(span, describe(host), f"{type(error).__name__}: {error}"))
            return False, None

    def uniform(self, host: HostExpr, type_: Type, span: Span) -> kir.Uniform:
        """The value of ``host`` at each launch, as a ``type_``."""
        known = self.uniforms.setdefault((host_identity(host), type_), (len(self.uniforms), HostValue(host, type_)))
        return kir.Uniform(known[0], type_, span)

    def known(self, expr: kir.Expr) -> Any:
        """The value of a captured array or of a component of one, which is then guarded; None for anything else."""
        match expr:
            case kir.Uniform(index):
                host = next(value.expr for number, value in self.uniforms.values() if number == index)
            case kir.Component(kir.Uniform(index), indices) if all(isinstance(each, kir.Const) for each in indices):
                base = next(value.expr for number, value in self.uniforms.values() if number == index)
                host = HostItem(base, tuple(each.value for each in indices if isinstance(each, kir.Const)))
            case _:
                return None
        if is_parameter(host):
            return None
        has_value, value = self.evaluate(host, expr.span)
        if has_value:
            self.guard_value(host, value)
        return value

    def guard_identity(self, host: HostExpr, value: Any) -> None:
        self._guard(host, IdentityGuard, value)

    def guard_type(self, host: HostExpr, type_: type) -> None:
        self._guard(host, TypeGuard, type_)

    def guard_value(self, host: HostExpr, value: Any) -> None:
        # A copy, since a list or an array may change in place.
        mutable = isinstance(value, list | tuple | np.ndarray)
        self._guard(host, ValueGuard, deepcopy(cast(Any, value)) if mutable else value)

    def guard_range(self, host: HostExpr, type_: ScalarType) -> None:
        self._guard(host, RangeGuard, type_)

    def guard_array(self, host: HostExpr, array: Any) -> None:
        self._guard(host, ArrayGuard, array.dtype, array.shape)

    def guard_structure(self, host: HostExpr, value: Any) -> None:
        self._guard(host, StructureGuard, structure_of(value))

    def _guard(self, host: HostExpr, kind: Callable[..., Guard], *facts: Any) -> None:
        if not isinstance(host, HostConst):
            # One elaboration sees one state of the host: only the ranges of a number can differ.
            key = (host_identity(host), kind, facts if kind is RangeGuard else None)
            if key not in self.guards:
                self.guards[key] = kind(host, reader(host), *facts)


def is_parameter(host: HostExpr) -> bool:
    """Whether ``host`` is a parameter of the kernel or a part of one, which is never known when it is compiled."""
    match host:
        case HostParameter():
            return True
        case HostItem(base, _) | HostAttribute(base, _):
            return is_parameter(base)
        case _:
            return False


def is_simple(expr: kir.Expr) -> bool:
    """Whether repeating ``expr`` costs nothing: a constant, a uniform or a component of one, or a local."""
    match expr:
        case kir.Component(kir.Uniform(), indices):
            return all(isinstance(index, kir.Const) for index in indices)
        case kir.Const() | kir.Uniform() | kir.ReadLocal():
            return True
        case _:
            return False


def is_stable(expr: kir.Expr) -> bool:
    """Whether ``expr`` gives the same value after other statements of the same expression have run."""
    if isinstance(expr, kir.ReadField | kir.ReadGlobal | kir.Random):
        return False
    return all(is_stable(child) for child in children(expr))
