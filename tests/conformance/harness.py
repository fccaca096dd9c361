"""What the conformance programs share: sizes, relations, and programs given as text."""

from __future__ import annotations

import itertools
import linecache
import re
import textwrap
import warnings

import numpy as np
import pytest

import ebb

SIZES = (0, 1, 63, 64, 65)
LARGE = 100_003

_programs = itertools.count()


def sizes_for(backend):
    """The sizes to run a program at: all of them, and on compiled backends a large one."""
    return SIZES if backend == "reference" else (*SIZES, LARGE)


def define(text, /, **names):
    """Runs ``text``, a module that defines kernels, with its source where Python keeps it; returns its names."""
    text = textwrap.dedent(text)
    filename = f"<conformance program {next(_programs)}>"
    linecache.cache[filename] = (len(text), None, text.splitlines(keepends=True), filename)
    namespace = {"ebb": ebb, "np": np, "__name__": "program", **names}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # Python warns of indexing a literal list by a tuple
        code = compile(text, filename, "exec", dont_inherit=True)
    exec(code, namespace)
    return namespace


def kernel_of(body, signature="r: rows", /, **names):
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


def evaluate_each(results, names=None, **fields):
    """As ``evaluate``, of all expressions that have a type in ``results``, in one kernel; the values by expression."""
    rows = rows_with(**fields)
    outs = {expression: rows.new_field(f"out_{i}", result) for i, (expression, result) in enumerate(results.items())}
    body = "\n".join(f"r.{out.name} = {expression}" for expression, out in outs.items())
    kernel_of(body, rows=rows, **(names or {}))(rows)
    return {expression: out.to_numpy() for expression, out in outs.items()}


def assert_close(actual, expected, dtype=np.float64, what=""):
    """Equal up to the rounding of a short computation in ``dtype``."""
    tolerance = 2e-5 if np.dtype(dtype) == np.float32 else 1e-12
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance, err_msg=what)


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


def offset_member(cells):
    """Adds ``c(1, 0)`` and the like to a grid of any dimension."""
    if cells.ndim == 1:

        @cells.member("__call__")
        def offset(c, i):
            return ebb.affine(cells, [[1, i]], c)

    elif cells.ndim == 2:

        @cells.member("__call__")
        def offset2(c, i, j):
            return ebb.affine(cells, [[1, 0, i], [0, 1, j]], c)

    else:

        @cells.member("__call__")
        def offset3(c, i, j, k):
            return ebb.affine(cells, [[1, 0, 0, i], [0, 1, 0, j], [0, 0, 1, k]], c)


def grid(shape, periodic=None, name="cells"):
    cells = ebb.Relation(name, shape=shape, periodic=periodic or (False,) * len(shape))
    cells.new_field("x", ebb.float64, init=np.arange(np.prod(shape), dtype=float).reshape(shape) ** 2)
    cells.new_field("y", ebb.float64, init=-1.0)
    offset_member(cells)
    return cells


def graph(vertex_count, edge_count, seed=0):
    """Random edges between random vertices, with int weights, so that sums are exact."""
    generator = np.random.default_rng(seed)
    vertices = ebb.Relation("vertices", size=vertex_count)
    edges = ebb.Relation("edges", size=edge_count)
    ends = generator.integers(0, max(vertex_count, 1), (edge_count, 2))
    edges.new_field("tail", vertices, init=ends[:, 0])
    edges.new_field("head", vertices, init=ends[:, 1])
    weight = generator.integers(-50, 50, edge_count)
    edges.new_field("w", ebb.int32, init=weight)
    edges.new_field("x", ebb.float64, init=weight / 8)
    return vertices, edges, ends, weight
