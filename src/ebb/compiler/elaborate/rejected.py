"""The Python that kernels do not have: what each construct is called, and what to write instead."""

from __future__ import annotations

import ast
from collections.abc import Mapping

_NO_OBJECTS = "a kernel has numbers, vectors, matrices and keys; make the object outside and capture what is needed"
_OUTSIDE = "put it outside the kernel"

REJECTED_STATEMENTS: Mapping[type[ast.stmt], tuple[str, str]] = {
    ast.FunctionDef: ("a nested function", "define it outside the kernel with @ebb.func"),
    ast.AsyncFunctionDef: ("'async def'", "define the function outside the kernel with @ebb.func"),
    ast.ClassDef: ("a class", "put it outside the kernel"),
    ast.Delete: ("'del'", "leave the name alone: locals end with the kernel"),
    ast.With: ("'with'", _OUTSIDE),
    ast.AsyncWith: ("'async with'", _OUTSIDE),
    ast.AsyncFor: ("'async for'", "use 'for'"),
    ast.Match: ("'match'", "use 'if' and 'elif'"),
    ast.Raise: ("'raise'", "use 'assert condition, \"text\"'"),
    ast.Try: ("'try'", "test for the condition with 'if', or state it with 'assert'"),
    ast.TryStar: ("'try'", "test for the condition with 'if', or state it with 'assert'"),
    ast.Import: ("'import'", "import the module outside the kernel"),
    ast.ImportFrom: ("'import'", "import the module outside the kernel"),
    ast.Global: ("'global'", "reduce into an ebb.Global, or pass the value as a parameter"),
    ast.Nonlocal: ("'nonlocal'", "reduce into an ebb.Global, or pass the value as a parameter"),
}

REJECTED_EXPRESSIONS: Mapping[type[ast.expr], tuple[str, str]] = {
    ast.NamedExpr: ("the walrus ':='", "assign in a statement of its own"),
    ast.Lambda: ("a lambda", "define a function outside the kernel with @ebb.func"),
    ast.Dict: ("a dictionary", _NO_OBJECTS),
    ast.Set: ("a set", _NO_OBJECTS),
    ast.ListComp: ("a comprehension", "use a 'for' loop, or write the vector out: [a, b, c]"),
    ast.SetComp: ("a comprehension", "use a 'for' loop"),
    ast.DictComp: ("a comprehension", "use a 'for' loop"),
    ast.GeneratorExp: ("a generator expression", "use a 'for' loop"),
    ast.Await: ("'await'", "call the function directly"),
    ast.Yield: ("'yield'", "store the value in a field"),
    ast.YieldFrom: ("'yield'", "store the values in a field"),
    ast.JoinedStr: ("an f-string outside print", "print it: print(f'...')"),
    ast.Starred: ("'*' before an argument or element", "write the elements out one by one"),
    ast.Slice: ("a slice", "write the components out: [v[0], v[1]]"),
}

REJECTED_CLAUSES: Mapping[str, tuple[str, str]] = {
    "for-else": (
        "'else' after 'for'",
        "set a local before the loop, change it before 'break', and test it after the loop",
    ),
    "while-else": ("'else' after 'while'", "set a local before the loop, change it before 'break', and test it after"),
    "**": ("'**' before an argument", "write the arguments out one by one"),
    "type comment": ("a variable annotation without a value", "assign the first value: it gives the type"),
}

REJECTED_PARAMETERS: Mapping[str, tuple[str, str]] = {
    "*args": ("'*args'", "name each parameter"),
    "**kwargs": ("'**kwargs'", "name each parameter"),
    "keyword-only": ("a keyword-only parameter", "make it an ordinary parameter: remove the '*' before it"),
}
