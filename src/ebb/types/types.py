"""The types of the language: scalars, keys, and small vectors and matrices of them (design section 3)."""

from __future__ import annotations

from enum import Enum
from numbers import Integral
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from ebb.records import record


class Kind(Enum):
    """What a scalar is a number of, in the order in which implicit coercion widens."""

    BOOL = "b"
    UNSIGNED = "u"
    SIGNED = "i"
    FLOAT = "f"


@runtime_checkable
class KeyTarget(Protocol):
    """What a key refers to: a relation, as far as the types need to know one."""

    @property
    def name(self) -> str: ...

    @property
    def key_dtype(self) -> np.dtype[Any]: ...


@record
class ScalarType:
    """A machine number, named as in NumPy. Calling it on the host converts, as in NumPy."""

    name: str
    kind: Kind
    bits: int

    @property
    def shape(self) -> tuple[int, ...]:
        return ()

    @property
    def scalar(self) -> ScalarType:
        return self

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(self.name.rstrip("_"))

    @property
    def size(self) -> int:
        return 1

    def __call__(self, value: Any) -> Any:
        return self.dtype.type(value)

    def __repr__(self) -> str:
        return self.name


@record(eq=False)
class KeyType:
    """An opaque reference to a row of ``target``. Two key types are equal when they refer to one relation."""

    target: KeyTarget

    @property
    def shape(self) -> tuple[int, ...]:
        return ()

    @property
    def scalar(self) -> KeyType:
        return self

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.target.key_dtype

    @property
    def size(self) -> int:
        return 1

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KeyType) and other.target is self.target

    def __hash__(self) -> int:
        return hash(("key", id(self.target)))

    def __repr__(self) -> str:
        return f"key({self.target.name})"


Element: TypeAlias = ScalarType | KeyType


@record
class VectorType:
    """``n`` scalars or keys in a row. Calling it on the host gives a NumPy array."""

    scalar: Element
    n: int

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.n,)

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.scalar.dtype

    @property
    def size(self) -> int:
        return self.n

    def __call__(self, *values: Any) -> Any:
        return _host_array(self, values)

    def __repr__(self) -> str:
        return f"vector({self.scalar!r}, {self.n})"


@record
class MatrixType:
    """``rows`` x ``cols`` scalars or keys, row-major. Calling it on the host gives a NumPy array."""

    scalar: Element
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.rows, self.cols)

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.scalar.dtype

    @property
    def size(self) -> int:
        return self.rows * self.cols

    def __call__(self, *values: Any) -> Any:
        return _host_array(self, values)

    def __repr__(self) -> str:
        return f"matrix({self.scalar!r}, {self.rows}, {self.cols})"


Type: TypeAlias = ScalarType | KeyType | VectorType | MatrixType

bool_ = ScalarType("bool_", Kind.BOOL, 8)
int32 = ScalarType("int32", Kind.SIGNED, 32)
int64 = ScalarType("int64", Kind.SIGNED, 64)
uint32 = ScalarType("uint32", Kind.UNSIGNED, 32)
uint64 = ScalarType("uint64", Kind.UNSIGNED, 64)
float32 = ScalarType("float32", Kind.FLOAT, 32)
float64 = ScalarType("float64", Kind.FLOAT, 64)

SCALARS: tuple[ScalarType, ...] = (bool_, int32, int64, uint32, uint64, float32, float64)
_BY_DTYPE = {scalar.dtype: scalar for scalar in SCALARS}


def vector(scalar: Any, n: int) -> VectorType:
    """The type of ``n`` values of ``scalar``, a scalar type, a key type or a relation.

    Raises:
        TypeError: ``scalar`` is no such type, or ``n`` is no integer >= 1.
    """
    return VectorType(_as_element(scalar), _as_extent(n))


def matrix(scalar: Any, rows: int, cols: int) -> MatrixType:
    """The type of ``rows`` x ``cols`` values of ``scalar``, row-major.

    Raises:
        TypeError: ``scalar`` is no scalar or key type, or an extent is no integer >= 1.
    """
    return MatrixType(_as_element(scalar), _as_extent(rows), _as_extent(cols))


def key(relation: KeyTarget) -> KeyType:
    """The type of references to the rows of ``relation``.

    Raises:
        TypeError: ``relation`` is no relation.
    """
    element = as_type(relation)
    if not isinstance(element, KeyType):
        raise TypeError(f"ebb.key takes a relation, not {relation!r}")
    return element


def is_type(value: object) -> bool:
    """Whether ``value`` may stand where a type is expected: a type, or a relation for its key type."""
    return isinstance(value, ScalarType | KeyType | VectorType | MatrixType) or hasattr(value, "__ebb_type__")


def as_type(value: Any) -> Type:
    """``value`` as a type; a relation stands for its key type.

    Raises:
        TypeError: ``value`` is neither.
    """
    if isinstance(value, ScalarType | KeyType | VectorType | MatrixType):
        return value
    if hasattr(value, "__ebb_type__"):
        return value.__ebb_type__()
    raise TypeError(f"expected an Ebb type such as ebb.float32 or ebb.vec3d, or a relation, not {value!r}")


def with_scalar(shaped: Type, scalar: Element) -> Type:
    """The type of the shape of ``shaped`` and the elements ``scalar``."""
    return shaped_type(scalar, shaped.shape)


def shaped_type(scalar: Element, shape: tuple[int, ...]) -> Type:
    """The scalar, vector or matrix type of ``shape``, which has at most two extents."""
    match shape:
        case ():
            return scalar
        case (n,):
            return VectorType(scalar, n)
        case (rows, cols):
            return MatrixType(scalar, rows, cols)
        case _:
            raise TypeError(f"a value has at most two axes, not {len(shape)}")


def from_dtype(dtype: np.dtype[Any]) -> ScalarType | None:
    """The scalar type that NumPy calls ``dtype``, or None where the language has none."""
    return _BY_DTYPE.get(np.dtype(dtype).newbyteorder("="))


def _as_element(value: Any) -> Element:
    element = as_type(value)
    if isinstance(element, ScalarType | KeyType):
        return element
    raise TypeError(f"the elements of a vector or matrix are scalars or keys, not {element!r}")


def _as_extent(n: Any) -> int:
    if isinstance(n, bool) or not isinstance(n, Integral) or n < 1:
        raise TypeError(f"the extent of a vector or matrix is an integer >= 1, not {n!r}")
    return int(n)


def _host_array(shaped: VectorType | MatrixType, values: tuple[Any, ...]) -> Any:
    array = np.asarray(values[0] if len(values) == 1 else values)
    if array.ndim == 0:
        return np.full(shaped.shape, array, dtype=shaped.dtype)
    if array.shape != shaped.shape:
        raise TypeError(f"{shaped!r} has the shape {shaped.shape}, the value {array.shape}")
    return array.astype(shaped.dtype)
