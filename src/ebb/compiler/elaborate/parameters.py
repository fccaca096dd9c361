"""The parameters of a kernel as its signature declares them."""

from __future__ import annotations

import ast
from collections import ChainMap
from collections.abc import Mapping
from functools import lru_cache
from types import CodeType
from typing import Any, TypeAlias

from ebb.compiler.elaborate.errors import BadAnnotation, NoRowParameter, UnresolvedAnnotation
from ebb.compiler.elaborate.errors_syntax import RejectedSyntax
from ebb.compiler.elaborate.rejected import REJECTED_PARAMETERS
from ebb.compiler.elaborate.source import Scope, SourceFunction
from ebb.errors import KernelSyntaxError, KernelTypeError
from ebb.records import record
from ebb.relations.relation import Relation
from ebb.types.types import KeyType, Type, as_type, is_type


@record
class FieldName:
    """The type of a parameter that is the name of a field: the name itself, known when the kernel is compiled."""

    name: str


ParameterType: TypeAlias = Type | FieldName


@record
class Declared:
    """The relation of a kernel's rows, None where the first parameter is bare, and what the others are declared as."""

    row: Relation | None
    parameters: Mapping[str, Type | type[str] | None]


def row_annotation(source: SourceFunction) -> Relation | None:
    """The relation of a kernel's rows, or None where the first parameter is bare.

    Raises:
        KernelSyntaxError: the kernel has no parameter, or one that kernels lack (``*args``).
        KernelTypeError: the annotation is no relation, or cannot be evaluated.
    """
    check_signature(source)
    parameters = positional(source.node)
    if not parameters:
        raise KernelSyntaxError(NoRowParameter(name_span(source), source.name))
    value = annotation(source, parameters[0])
    if value is None or isinstance(value, Relation):
        return value
    if isinstance(value, KeyType) and isinstance(value.target, Relation):
        return value.target
    raise KernelTypeError(_bad(source, parameters[0], value, "the relation whose rows the kernel runs on"))


def parameter_types(source: SourceFunction) -> Mapping[str, Type | type[str] | None]:
    """What the parameters after the row are declared as: a type, ``str`` for the name of a field, None where bare.

    Raises:
        KernelSyntaxError: the kernel has no parameter, or one that kernels lack (``*args``).
        KernelTypeError: an annotation is neither, or cannot be evaluated.
    """
    row_annotation(source)
    return {parameter.arg: declared_type(source, parameter) for parameter in positional(source.node)[1:]}


def declared_type(source: SourceFunction, parameter: ast.arg) -> Type | type[str] | None:
    """The annotation of one parameter.

    Raises:
        KernelTypeError: it is neither a type nor ``str``, or cannot be evaluated.
    """
    value = annotation(source, parameter)
    if value is None or value is str:
        return value
    if is_type(value):
        return as_type(value)
    raise KernelTypeError(_bad(source, parameter, value, "an Ebb type, a relation, or 'str' for the name of a field"))


def annotation(source: SourceFunction, parameter: ast.arg) -> Any:
    """The value of a parameter's annotation, None where it has none. Text is evaluated where the decorator stands.

    Raises:
        KernelTypeError: the text cannot be evaluated.
    """
    if parameter.annotation is None:
        return None
    if source.trail is not None:
        source.trail.annotated(source.function, parameter.arg)
    try:
        return annotated(source, parameter.arg)
    except Exception as error:  # whatever the user's own expression raises
        reason = f"{type(error).__name__}: {error}"
        span = source.span(parameter.annotation)
        raise KernelTypeError(UnresolvedAnnotation(span, source.name, parameter.arg, reason)) from error


def annotated(source: SourceFunction | Scope, name: str) -> Any:
    """The annotation of the parameter ``name``, None where it has none; raises whatever its evaluation raises."""
    value = source.function.__annotations__.get(name)
    value = _evaluated(source, value) if isinstance(value, str) else value
    return None if value is Any else value  # Any is how typed programs write a bare parameter


def plain_signature(scope: Scope) -> Declared | None:
    """What the signature declares, without a look at its source, which has to say why where this is None."""
    code = scope.function.__code__
    if code.co_flags & _VARIADIC or code.co_kwonlyargcount or not code.co_argcount:
        return None
    try:
        row, *types = [annotated(scope, name) for name in code.co_varnames[: code.co_argcount]]
    except Exception:  # whatever the user's own expression raises
        return None
    row = row.target if isinstance(row, KeyType) else row
    if not (row is None or isinstance(row, Relation)) or not all(
        [each in (None, str) or is_type(each) for each in types]
    ):
        return None
    declared = [each if each is None or each is str else as_type(each) for each in types]
    return Declared(row, dict(zip(code.co_varnames[1:], declared, strict=False)))


_VARIADIC = 0x04 | 0x08  # CO_VARARGS, CO_VARKEYWORDS


def check_signature(source: SourceFunction) -> None:
    """Checks that a function has only parameters that kernels, funcs and members may have.

    Raises:
        KernelSyntaxError: it has ``*args``, ``**kwargs`` or keyword-only parameters.
    """
    arguments = source.node.args
    wrong = {
        "*args": [arguments.vararg],
        "**kwargs": [arguments.kwarg],
        "keyword-only": arguments.kwonlyargs,
    }
    diagnostics = [
        RejectedSyntax(source.span(parameter), *REJECTED_PARAMETERS[kind])
        for kind, parameters in wrong.items()
        for parameter in parameters
        if parameter is not None
    ]
    if diagnostics:
        raise KernelSyntaxError(*diagnostics)


def positional(node: ast.FunctionDef) -> list[ast.arg]:
    """The parameters of a function in order."""
    return [*node.args.posonlyargs, *node.args.args]


def name_span(source: SourceFunction) -> Any:
    """Where the name of the function stands in its definition."""
    whole = source.span(source.node)
    line = source.source.line(whole.line)
    column = max(line.find(source.name, whole.column + len("def")), 0)
    return type(whole)(source.source, whole.line, column, whole.line, column + len(source.name))


def _evaluated(source: SourceFunction | Scope, text: str) -> Any:
    filled = {name: cell.cell_contents for name, cell in source.cells.items() if _is_set(cell)}
    value = eval(_code(text), dict(source.namespace), ChainMap[str, Any](filled, dict(source.locals)))
    # Under the future import a quoted annotation is text of a text.
    return _evaluated(source, value) if isinstance(value, str) else value


@lru_cache(maxsize=256)
def _code(text: str) -> CodeType:
    return compile(text.lstrip(" \t"), "<string>", "eval")


def _is_set(cell: Any) -> bool:
    try:
        cell.cell_contents  # noqa: B018 - reading it is the test
    except ValueError:
        return False
    return True


def _bad(source: SourceFunction, parameter: ast.arg, value: Any, expected: str) -> BadAnnotation:
    assert parameter.annotation is not None
    text = repr(value)
    shown = text if len(text) <= 60 and "\n" not in text else f"a {type(value).__name__}"
    return BadAnnotation(source.span(parameter.annotation), parameter.arg, shown, expected)
