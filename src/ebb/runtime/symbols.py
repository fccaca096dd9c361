"""The functions of the C library that machine code may call: mathematics, and what LLVM itself brings in."""

from __future__ import annotations

import ctypes
import re
import struct
from collections.abc import Iterator, Mapping
from functools import cache

import llvmlite.binding as llvm

_MATH = (
    "sqrt", "cbrt", "exp", "exp2", "exp10", "expm1", "log", "log2", "log10", "log1p", "pow", "sin", "cos",
    "sincos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "hypot",
    "fmod", "floor", "ceil", "trunc", "rint", "round", "roundeven", "nearbyint", "fma", "fmin", "fmax", "ldexp",
    "frexp", "copysign", "fabs", "erf", "erfc", "tgamma", "lgamma",
)  # fmt: skip
_MEMORY = ("memcpy", "memmove", "memset")

_NAMES = {
    name: name.encode() + b"\0" for name in (*_MEMORY, *(each + suffix for each in _MATH for suffix in ("", "f")))
}
"""The names of the functions, as they end in object code."""

_VECTOR_NAME = re.compile(rb"_ZGV[bde]N\d+v+_\w+")


def libmvec_versions(marks: Mapping[tuple[int, int], str]) -> Iterator[tuple[int, int]]:
    """The versions of glibc's vector functions that this process has: those whose mark is among its symbols."""
    library = _libmvec()
    for version, symbol in marks.items():
        if getattr(library, symbol, None) is not None:
            yield version


@cache
def _libmvec() -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL("libmvec.so.1")
    except OSError:
        return None


def external_symbols(image: bytes) -> Mapping[str, int]:
    """The addresses of the functions that the object code ``image`` may call, by the names under which it does.

    Looking up all of them, and handing each to the linker, would take longer than all else of a launch from the cache.
    """
    # In a table of strings "sin" may be the end of "asin": rather one too many.
    strings = _strings(image)
    named = [name for name, ended in _NAMES.items() if ended in strings]
    named += sorted({name.decode() for name in _VECTOR_NAME.findall(strings)})
    found = {name: _address(name) for name in named}
    return {name: address for name, address in found.items() if address is not None}


_ELF64 = b"\x7fELF\x02\x01"
_STRINGS = 3  # SHT_STRTAB


def _strings(image: bytes) -> bytes:
    """The tables of strings of a 64-bit ELF object, in which all names stand; of other formats the whole object."""
    if not image.startswith(_ELF64):
        return image
    (headers,) = struct.unpack_from("<Q", image, 0x28)
    size, count = struct.unpack_from("<HH", image, 0x3A)
    tables = b""
    for header in range(headers, headers + size * count, size):
        (kind,) = struct.unpack_from("<I", image, header + 4)
        if kind == _STRINGS:
            offset, length = struct.unpack_from("<QQ", image, header + 24)
            tables += image[offset : offset + length]
    return tables


@cache
def _address(name: str) -> int | None:
    address: int | None = llvm.address_of_symbol(name)
    if address is not None:
        return address
    for library in (_libmvec(),) if name.startswith("_ZGV") else _libraries():
        function = getattr(library, name, None)
        if function is not None:
            return ctypes.cast(function, ctypes.c_void_p).value
    return None


@cache
def _libraries() -> tuple[ctypes.CDLL, ...]:
    """Where to look for what the process itself does not offer; to find a library may take a process of its own."""
    from ctypes.util import find_library

    names = [find_library("m"), None]
    result: list[ctypes.CDLL] = []
    for name in names:
        try:
            result.append(ctypes.CDLL(name))
        except (OSError, TypeError):
            continue
    return tuple(result)
