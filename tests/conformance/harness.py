"""What the conformance programs share: backends, sizes, and programs given as text."""

from __future__ import annotations

import itertools
import linecache
import re
import textwrap

import numpy as np
import pytest

import ebb

BACKENDS = ("cpu", "reference")
SIZES = (0, 1, 63, 64, 65)
LARGE = 100_003

_programs = itertools.count()


def sizes_for(backend):
    """The sizes to run a program at: all of them, and on compiled backends a large one."""
    return SIZES if backend == "reference" else (*SIZES, LARGE)


def define(text, **names):
    """Runs ``text``, a module that defines kernels, with its source where Python keeps it; returns its names."""
    text = textwrap.dedent(text)
    filename = f"<conformance program {next(_programs)}>"
    linecache.cache[filename] = (len(text), None, text.splitlines(keepends=True), filename)
    namespace = {"ebb": ebb, "np": np, "__name__": "program", **names}
    exec(compile(text, filename, "exec", dont_inherit=True), namespace)
    return namespace


def kernel_of(body, signature="r: rows", **names):
    """The kernel whose body is ``body``, on the relation ``rows`` of ``names``, or with another signature."""
    lines = textwrap.indent(textwrap.dedent(body).strip("\n"), "    ")
    return define(f"@ebb.kernel\ndef program({signature}):\n{lines}\n", **names)["program"]


def rows_with(**fields):
    """A relation ``rows`` with ``fields``, each a pair of a type and one value a row."""
    rows = ebb.Relation("rows", size=len(next(iter(fields.values()))[1]))
    for name, (field_type, values) in fields.items():
        rows.new_field(name, field_type, init=np.asarray(values, dtype=field_type.dtype))
    return rows


def evaluate(expression, result, names=None, **fields):
    """What ``r.out = expression`` stores in a field of the type ``result``, for rows ``r`` that hold ``fields``."""
    rows = rows_with(**fields) if fields else ebb.Relation("rows", size=1)
    out = rows.new_field("out", result)
    kernel_of(f"r.out = {expression}", rows=rows, **(names or {}))(rows)
    return out.to_numpy()


def assert_close(actual, expected, dtype=np.float64):
    """Equal up to the rounding of a short computation in ``dtype``."""
    tolerance = 2e-5 if np.dtype(dtype) == np.float32 else 1e-12
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


def rejects(exception, code, run):
    """``run`` raises ``exception`` with a diagnostic whose code begins with ``code``; returns the exception."""
    with pytest.raises(exception) as caught:
        run()
    assert type(caught.value) is exception, f"{type(caught.value).__name__} instead of {exception.__name__}"
    assert any(each.startswith(code) for each in caught.value.codes), f"{caught.value.codes}: {caught.value}"
    return caught.value


def names_row(error, *indices):
    """Whether the message of ``error`` names the row with these indices: ``row cells[2, 3]``, or ``row 2``."""
    return re.search(rf"row (\w+\[)?{', '.join(map(str, indices))}\b", str(error)) is not None
