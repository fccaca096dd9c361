"""What ``@ebb.func`` makes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

from ebb.compiler.elaborate.parameters import check_signature
from ebb.compiler.elaborate.source import Scope, SourceFunction, find_source


class Func:
    """A function that kernels call: inlined, and typed by its arguments at each call."""

    def __init__(
        self, function: Callable[..., Any], text: str | None = None, frame_locals: Mapping[str, Any] | None = None
    ) -> None:
        functools.update_wrapper(self, function)
        self.name: str = getattr(function, "__name__", repr(function))
        self.function = function
        self._text = text
        self._frame_locals = frame_locals

    @functools.cached_property
    def source(self) -> SourceFunction:
        """How the function is written.

        Raises:
            KernelSyntaxError: there is no source, or the function has parameters that funcs lack.
        """
        source = find_source(self.function, self._text, self._frame_locals)
        check_signature(source)
        return source

    @property
    def scope(self) -> Scope:
        """The function and the names around it."""
        return Scope(self.function, self._text, self._frame_locals or {})  # type: ignore[arg-type]

    def __call__(self, *arguments: Any, **named: Any) -> NoReturn:
        """Raises TypeError: a func runs in kernels only."""
        raise TypeError(f"'{self.name}' is an ebb.func: call it from a kernel; on the host, call a Python function")

    def __repr__(self) -> str:
        return f"<ebb.func {self.name}>"


def member_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """The Python function of a member, which may have been made a func too."""
    return function.function if isinstance(function, Func) else function
