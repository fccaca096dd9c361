"""Sorting keys: which row comes first, second, and so on, equal keys in the order in which they are given."""

from __future__ import annotations

import numpy as np

from ebb.relations.storage import Rows
from ebb.runtime.buffer import Array

_DIGIT = 16
"""Bits of a digit: NumPy sorts integers of this size by counting, in linear time, and wider ones by comparisons."""


def stable_order(keys: Array) -> Rows:
    """The places of ``keys`` in ascending order of the keys, as ``np.argsort(keys, kind="stable")`` gives them.

    Sorted digit by digit, in a third of the time.

    Args:
        keys: integers from -1 on.
    """
    if not keys.size or bool((keys[:-1] <= keys[1:]).all()):
        return np.arange(keys.size)
    rest = (keys + 1).astype(np.uint64 if keys.dtype.itemsize == 8 else np.uint32)
    bits = int(rest.max()).bit_length()
    order = np.argsort(rest.astype(np.uint16), kind="stable")
    for shift in range(_DIGIT, bits, _DIGIT):
        digits = (rest >> rest.dtype.type(shift)).astype(np.uint16)
        order = order[np.argsort(digits[order], kind="stable")]
    return order
