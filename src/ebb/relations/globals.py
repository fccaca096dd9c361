"""Globals, which kernels read and reduce, and constants, which fix the type of a number."""

from __future__ import annotations

from typing import Any

import numpy as np

from ebb.errors import RelationError
from ebb.records import record
from ebb.relations.errors import NotNumbers
from ebb.relations.loading import Place, converted
from ebb.runtime.buffer import Array, Buffer
from ebb.runtime.living import Living
from ebb.runtime.recording import recorder, refuse
from ebb.types.types import KeyType, Type, as_type


class Global:
    """A value that belongs to no row: kernels read it, or reduce into it with one operator.

    Attributes:
        type: of the value, a scalar, vector or matrix of numbers or bools.
        buffer: the memory that ``data`` lies in.
    """

    __slots__ = ("__weakref__", "buffer", "type")

    def __init__(self, type: Any, initial: Any) -> None:
        """A global of ``type`` that holds ``initial``; one number fills every component.

        Raises:
            TypeError: ``type`` is no type.
            RelationError: ``type`` is of keys, or ``initial`` does not fit.
        """
        self.type: Type = _numeric(as_type(type), "global")
        self.buffer = Buffer(self.type.shape, self.type.dtype)
        self.buffer.overwrite(self._converted(initial))
        all_globals.add(self)

    @property
    def data(self) -> Array:
        """The value as an array of ``type.shape``, at an address that never changes.

        Taking it waits for a device that has a newer one. Who writes to it calls ``buffer.changed_on_host``.
        """
        return self.buffer.host

    @property
    def value(self) -> Any:
        """The value: a Python number, or a copy as a NumPy array. Setting it fills every component with one number.

        Raises:
            RelationError: what is set does not fit in shape, kind or range; the value is then unchanged.
            BackendError: it is read while a step is being captured.
        """
        refuse("reading the value of a global", "read it when the step has run")
        return self.data.copy() if self.type.shape else self.data.item()

    @value.setter
    def value(self, value: Any) -> None:
        fitting = self._converted(value)
        by = recorder()
        if by is None:
            self.buffer.overwrite(fitting)
        else:
            by.record_set(self, np.array(np.broadcast_to(fitting, self.type.shape), dtype=self.type.dtype))

    def _converted(self, value: Any) -> Array:
        return converted(value, Place("global", self.type, ()))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        if copy is False:
            raise ValueError("the value of a global is copied to NumPy")
        refuse("reading the value of a global", "read it when the step has run")
        return np.array(self.data, dtype=dtype)

    def __repr__(self) -> str:
        return f"Global({self.type!r}, {self.data.tolist()!r})"


all_globals: Living[Global] = Living()
"""All globals that there are."""


@record
class Constant:
    """A number of a fixed type. ``value`` is a Python number or bool, or nested tuples of these."""

    value: Any
    type: Type

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.value, dtype=self.type.dtype if dtype is None else dtype)

    def __repr__(self) -> str:
        return f"constant({self.value!r}, {self.type!r})"


def constant(value: Any, type: Any) -> Constant:
    """``value`` rounded to ``type``, for use in kernels, where it keeps that type; one number fills every component.

    Raises:
        TypeError: ``type`` is no type.
        RelationError: ``type`` is of keys, or ``value`` does not fit.
    """
    fixed = _numeric(as_type(type), "constant")
    array = np.broadcast_to(converted(value, Place("constant", fixed, ())), fixed.shape)
    return Constant(_nested(array.tolist()), fixed)


def _nested(value: Any) -> Any:
    return tuple(_nested(item) for item in value) if isinstance(value, list) else value  # pyright: ignore


def _numeric(type_: Type, what: str) -> Type:
    if isinstance(type_.scalar, KeyType):
        raise RelationError(NotNumbers(what, repr(type_)))
    return type_
