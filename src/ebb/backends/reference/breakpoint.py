"""``breakpoint()`` in a kernel: the debugger sees the kernel's line and its variables by their names."""

from __future__ import annotations

import ast
import linecache
import os
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np

from ebb.compiler import kir
from ebb.compiler.failures import row_name
from ebb.diagnostics.span import Source, Span
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.types.types import KeyType

_HOOK = "__breakpointhook__"


@record
class RowView:
    """A key as the debugger shows it. Its attributes are the values of the fields in that row."""

    relation: Relation
    position: int

    def __getattr__(self, name: str) -> Any:
        attribute = self.relation.attribute(name)
        if not isinstance(attribute, Field):
            raise AttributeError(f"relation {self.relation.name!r} has no field {name!r}")
        value = attribute.data[self.position]
        target = attribute.target
        return RowView(target, int(value)) if target is not None and not np.ndim(value) else value

    def __repr__(self) -> str:
        return row_name(self.relation, self.position)


def stop(kernel: str, span: Span, variables: Iterable[tuple[kir.Local, Any]]) -> None:
    """Calls ``sys.breakpointhook`` from a frame that stands in the user's file, with ``variables`` as its globals.

    So ``PYTHONBREAKPOINT`` and a debugger's own hook work as in any Python function.
    """
    _keep_source(span.source)
    call = ast.Expr(ast.Call(ast.Name(_HOOK, ast.Load()), [], []))
    after = ast.Pass()
    for node in ast.walk(call):
        _place(node, span.line)
    # Debuggers stop at the line that runs next: let that be the one after the call, as in a function.
    _place(after, min(span.line + 1, max(span.line, len(span.source.text.splitlines()))))
    code = compile(ast.Module([call, after], []), span.source.filename, "exec").replace(co_name=kernel)
    names = {local.name: _shown(local, value) for local, value in variables}
    exec(code, names | {_HOOK: sys.breakpointhook, "__name__": "__kernel__"})


def _place(node: ast.AST, line: int) -> None:
    if isinstance(node, ast.expr | ast.stmt):
        node.lineno = node.end_lineno = line
        node.col_offset = node.end_col_offset = 0


def _shown(local: kir.Local, value: Any) -> Any:
    if isinstance(local.type, KeyType) and isinstance(local.type.target, Relation):
        return RowView(local.type.target, value)
    return value


def _keep_source(source: Source) -> None:
    """Lets debuggers list source that is in no file."""
    if source.filename not in linecache.cache and not os.path.exists(source.filename):
        lines = source.text.splitlines(keepends=True)
        linecache.cache[source.filename] = (len(source.text), None, lines, source.filename)
