"""From a function to its source: the one place where Ebb looks at how Python keeps programs."""

from __future__ import annotations

import ast
import builtins
import linecache
import os
import stat
from collections.abc import Mapping
from functools import lru_cache
from types import CellType, CodeType, FunctionType
from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakKeyDictionary

from ebb.compiler.elaborate.errors import NotAFunction, SourceChanged, SourceNotFound
from ebb.diagnostics.span import Source, Span
from ebb.errors import KernelSyntaxError
from ebb.records import field, record
from ebb.runtime.digest import key_of

if TYPE_CHECKING:
    from ebb.compiler.elaborate.trail import Trail

Located: TypeAlias = ast.expr | ast.stmt | ast.arg | ast.keyword
"""The nodes of a syntax tree that say where they stand."""


class Scope:
    """A function and the names around it, without its source.

    Attributes:
        function: the function.
        text: the text that defines it, where that was given.
        locals: what the frame that decorated it had, for annotations that Python keeps as text.
        cells: the variables of enclosing functions that it captures.
        namespace: the globals of its module.
    """

    __slots__ = ("cells", "function", "locals", "namespace", "text")

    def __init__(self, function: FunctionType, text: str | None, frame_locals: Mapping[str, Any]) -> None:
        self.function = function
        self.text = text
        self.locals = frame_locals
        self.cells = _cells(function)
        self.namespace: Mapping[str, Any] = function.__globals__

    @property
    def builtins(self) -> Mapping[str, Any]:
        """The builtin names that it sees."""
        return _builtins_in(self.namespace)

    def source(self) -> SourceFunction:
        """``find_source`` of the function."""
        return find_source(self.function, self.text, self.locals)


@record(eq=False)
class SourceFunction:
    """A function as it is written, and the names around it.

    Attributes:
        node: its definition, as a syntax tree with the line numbers of the file.
        cells: the variables of enclosing functions that it captures.
        namespace: the globals of its module.
        locals: what the frame that decorated it had, for annotations that Python keeps as text.
        trail: notes what is looked at outside of the function, where somebody asks.
    """

    name: str
    function: FunctionType
    node: ast.FunctionDef
    source: Source
    cells: Mapping[str, CellType]
    namespace: Mapping[str, Any]
    locals: Mapping[str, Any] = field(repr=False)
    trail: Trail | None = field(default=None, repr=False)

    def span(self, node: Located, caller: Span | None = None) -> Span:
        """Where ``node`` stands. The columns of ``ast`` count UTF-8 bytes, those of spans characters."""
        line, end_line = node.lineno, node.end_lineno or node.lineno
        column, end_column = node.col_offset, node.end_col_offset or node.col_offset
        source = self.source
        if source.text.isascii():  # Python knows without looking
            return Span(source, line, column, end_line, end_column, caller)
        return Span(source, line, self._column(line, column), end_line, self._column(end_line, end_column), caller)

    def _column(self, line: int, byte: int) -> int:
        lines = _lines(self.source.text)
        text = lines[line - 1] if line <= len(lines) else ""
        return byte if text.isascii() else len(text.encode()[:byte].decode(errors="ignore"))

    @property
    def builtins(self) -> Mapping[str, Any]:
        """The builtin names that the function sees."""
        return _builtins_in(self.namespace)


def _cells(function: FunctionType) -> Mapping[str, CellType]:
    return dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))


def _builtins_in(namespace: Mapping[str, Any]) -> Mapping[str, Any]:
    found: Any = namespace.get("__builtins__", builtins)
    return found if isinstance(found, dict) else vars(found)  # pyright: ignore[reportUnknownVariableType]


def find_source(
    function: Any, text: str | None = None, frame_locals: Mapping[str, Any] | None = None
) -> SourceFunction:
    """Finds how ``function`` is written.

    Args:
        function: a Python function written with ``def``.
        text: the text that defines it, for functions whose source Python does not keep.
        frame_locals: the locals of the frame that decorated it.

    Raises:
        KernelSyntaxError: it is no such function, there is no source, or the source is not that function's.
    """
    if not isinstance(function, FunctionType):
        raise KernelSyntaxError(NotAFunction(function))
    code = function.__code__
    if function.__name__ == "<lambda>" or code.co_name == "<lambda>" or code.co_flags & _COROUTINE:
        raise KernelSyntaxError(NotAFunction(function))
    given = text is not None
    if text is None:
        text = _kept_source(code, function.__globals__)
    if not text:
        raise KernelSyntaxError(SourceNotFound(function.__name__, code.co_filename))
    node, source = _locate(code, text, given)
    return _source_function(function, node, source, frame_locals or {})


def source_of(function: Any) -> SourceFunction:
    """``find_source`` of a function that is looked up again and again, such as a member's."""
    if not isinstance(function, FunctionType):
        return find_source(function)  # which says that it is no function
    known = _located.get(function)
    if known is None:
        found = find_source(function)
        known = _located[function] = (found.node, found.source)
    return _source_function(function, *known, {})


_located: WeakKeyDictionary[FunctionType, tuple[ast.FunctionDef, Source]] = WeakKeyDictionary()
"""Where functions are written. Nothing here may refer to a function: its variables hold relations, and their memory."""


def _source_function(
    function: FunctionType, node: ast.FunctionDef, source: Source, frame_locals: Mapping[str, Any]
) -> SourceFunction:
    code = function.__code__
    return SourceFunction(code.co_name, function, node, source, _cells(function), function.__globals__, frame_locals)


_PACKAGE = os.path.join(os.path.dirname(os.path.dirname(os.path.dirname(__file__))), "")


def text_key(function: FunctionType, text: str | None) -> str | None:
    """What tells the text around ``function`` from any other, None where there is none.

    Of functions of this package it is the file: who keeps the key knows in which state the package is.
    """
    if text is not None:
        return key_of(text)
    filename = function.__code__.co_filename
    if filename.startswith(_PACKAGE):
        return filename
    text = _kept_source(function.__code__, function.__globals__)
    if not text:
        return None
    known = _keys.get(filename)
    if known is None or known[0] is not text:
        known = _keys[filename] = (text, key_of(filename, text))
    return known[1]


_keys: dict[str, tuple[str, str]] = {}
"""The text of each file, and its key."""

_COROUTINE = 0x80 | 0x200  # CO_COROUTINE, CO_ASYNC_GENERATOR


def _kept_source(code: CodeType, namespace: Mapping[str, Any]) -> str:
    # linecache knows files, archives and loaders (through the globals), and the cells of notebooks.
    lines = linecache.getlines(code.co_filename, dict(namespace))
    if lines:
        known = _joined.get(code.co_filename)
        if known is None or known[0] is not lines:
            known = _joined[code.co_filename] = (lines, "".join(lines))
        return known[1]
    return _redirected_input() if code.co_filename == "<stdin>" else ""


_joined: dict[str, tuple[list[str], str]] = {}
"""The lines of each file as linecache has them, and its text, which then is one for all functions in it."""


def _redirected_input() -> str:
    """The program itself, where it is a file that was redirected to standard input: ``python < program.py``."""
    try:
        status = os.fstat(0)
        if not stat.S_ISREG(status.st_mode):
            return ""
        return os.pread(0, status.st_size, 0).decode()
    except (OSError, UnicodeDecodeError):
        return ""


def _locate(code: CodeType, text: str, given: bool) -> tuple[ast.FunctionDef, Source]:
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    alone = None if given else _parse_alone(code, text)
    if alone is not None:
        _check_parameters(code, alone)
        return alone, Source(code.co_filename, text)
    try:
        tree = _parse(text)
    except SyntaxError as error:
        raise KernelSyntaxError(_changed(code, f"its line {error.lineno} is no Python")) from error
    named = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == code.co_name]
    found = [node for node in named if _first_line(node) == code.co_firstlineno]
    if given and not found:  # the text may be a part of what was run, so that its lines are numbered otherwise
        found = named
    if len(found) != 1:
        reason = "there is no such function" if not found else f"there are {len(found)} functions of that name"
        raise KernelSyntaxError(_changed(code, reason))
    _check_parameters(code, found[0])
    return found[0], Source(code.co_filename, text)


def _check_parameters(code: CodeType, node: ast.FunctionDef) -> None:
    names = [each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    count = code.co_argcount + code.co_kwonlyargcount
    if list(code.co_varnames[:count]) != names:
        raise KernelSyntaxError(_changed(code, "its parameters differ"))


def _changed(code: CodeType, reason: str) -> SourceChanged:
    return SourceChanged(code.co_name, code.co_filename, code.co_firstlineno, reason)


def _first_line(node: ast.FunctionDef) -> int:
    return min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])


_MOST_ATTEMPTS = 8


def _parse_alone(code: CodeType, text: str) -> ast.FunctionDef | None:
    """The definition at the line where ``code`` begins; None where only the whole file tells, or there is no such one.

    A large file takes longer to parse than a launch may take. The definition ends before a line that is not indented
    further than it, unless that line goes on with a string or a bracket, when the stretch before it does not parse.
    """
    start, lines = code.co_firstlineno - 1, _lines(text)
    if start >= len(lines) or "\f" in text:  # a form feed sets the indentation to nothing
        return None
    indented = _indentation(lines[start])
    # Blank lines before it: the numbers of its lines are those of the file.
    before = "\n" * (start - 1) + "if True:\n" if indented else "\n" * start
    attempts = 0
    # Behind the decorators, which alone are no Python.
    first = next((number for number in range(start, len(lines)) if lines[number].lstrip().startswith("def ")), start)
    for end in range(first + 1, len(lines) + 1):
        last = end == len(lines)
        if not last and (_indentation(lines[end]) > indented or lines[end].lstrip()[:1] in ("", "#")):
            continue
        try:
            tree = ast.parse(before + "\n".join(lines[start:end]))
        except SyntaxError:
            attempts += 1
            if attempts == _MOST_ATTEMPTS:
                return None
            continue
        return _only_definition(tree, code)
    return None


def _only_definition(tree: ast.Module, code: CodeType) -> ast.FunctionDef | None:
    match tree.body:
        case [ast.FunctionDef() as node] | [ast.If(body=[ast.FunctionDef() as node])]:
            found = node.name == code.co_name and _first_line(node) == code.co_firstlineno
            return node if found else None
        case _:
            return None


def _indentation(line: str) -> int:
    """The column where ``line`` begins, as Python counts it."""
    blank = line[: len(line) - len(line.lstrip(" \t"))]
    return len(blank.expandtabs(8))


@lru_cache(maxsize=64)
def _lines(text: str) -> list[str]:
    return text.split("\n")


@lru_cache(maxsize=64)
def _parse(text: str) -> ast.Module:
    try:
        return ast.parse(text)
    except IndentationError:
        # The text of an indented function: below a condition it is a program, one line further down.
        tree = ast.parse(f"if True:\n{text}")
        return ast.increment_lineno(tree, -1)  # type: ignore[return-value]
