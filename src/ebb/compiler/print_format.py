"""The text that ``print`` in a kernel writes for a value, on every backend."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ebb.compiler.failures import row_name
from ebb.relations.relation import Relation
from ebb.types.types import KeyType, Type


def format_value(value: Any, type: Type, spec: str = "") -> str:
    """``value`` as ``print`` shows it, or under the format specification ``spec``, which applies to each component.

    Args:
        value: a NumPy scalar or array of ``type``; keys are positions.
        type: of the value.
        spec: what stands after the colon in an f-string.
    """
    if isinstance(type.scalar, KeyType):
        target = type.scalar.target
        assert isinstance(target, Relation)
        return _nested(value, lambda key: format(row_name(target, key), spec))
    if not spec:
        return str(value)
    return _nested(value, lambda number: format(number, spec))


def _nested(value: Any, show: Callable[[Any], str]) -> str:
    if np.ndim(value) == 0:
        return show(np.asarray(value).item())
    return f"[{' '.join(_nested(part, show) for part in value)}]"
