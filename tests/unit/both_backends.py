"""Runs a hand-built kernel on the backends, on the same data."""

from __future__ import annotations

import numpy as np

import ebb
from backends import lacking
from ebb.backends import reference
from ebb.backends.backend import CheckedKernel, Hints
from ebb.backends.cpu import cpu_backend
from ebb.backends.select import current_backend
from ebb.compiler.kir_verify import verify_kernel
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.stencil import check_stencil, collect_stencil
from ebb.compiler.scatter.step import Step


def checked(kernel, fastmath=False):
    verify_kernel(kernel)
    unchecked = tuple(access.node for access in collect_stencil(kernel))
    return CheckedKernel(Step(kernel, check_phases(kernel), unchecked), Hints(fastmath=fastmath))


def changed_fields(kernel):
    return [field for field, phase in check_phases(kernel).fields.items() if phase.changed]


def launch(executable, kernel, rows, uniforms=()):
    for field in check_phases(kernel).fields:
        if field.grouping is not None:
            field.grouping.refresh()
    check_stencil(kernel, collect_stencil(kernel), rows)
    try:
        executable.bind(rows).run(uniforms)
    finally:
        for field in changed_fields(kernel):
            field.rewritten()


def run_cpu(kernel, rows=None, uniforms=(), threads=1):
    executable = cpu_backend(threads).prepare(checked(kernel))
    launch(executable, kernel, kernel.relation if rows is None else rows, uniforms)


def run_opencl(kernel, rows=None, uniforms=()):
    with ebb.backend("opencl"):
        executable = current_backend().prepare(checked(kernel))
    launch(executable, kernel, kernel.relation if rows is None else rows, uniforms)


def run_each(runs, kernel):
    """The values of the changed fields and globals after each of ``runs``, from the same start."""
    fields, totals = changed_fields(kernel), list(check_phases(kernel).globals)
    before = [place.data.copy() for place in (*fields, *totals)]
    for run in runs:
        for place, value in zip((*fields, *totals), before, strict=True):
            place.data[...] = value
            place.buffer.changed_on_host()
        run()
        yield [place.data.copy() for place in (*fields, *totals)]


def run_both(kernel, rows=None, uniforms=(), threads=2):
    """The values of the changed fields and globals on the reference and on cpu, from the same start."""
    rows = kernel.relation if rows is None else rows
    prepared = reference.reference_backend().prepare(checked(kernel))
    runs = (lambda: launch(prepared, kernel, rows, uniforms), lambda: run_cpu(kernel, rows, uniforms, threads))
    return tuple(run_each(runs, kernel))


def assert_agree(kernel, rows=None, uniforms=(), threads=2, rtol=0.0):
    """The backends agree: bit for bit, or where ``rtol`` is given, up to that, NaN where NaN."""
    rows = kernel.relation if rows is None else rows
    prepared = reference.reference_backend().prepare(checked(kernel))
    runs = [lambda: launch(prepared, kernel, rows, uniforms), lambda: run_cpu(kernel, rows, uniforms, threads)]
    if not lacking("opencl"):
        runs.append(lambda: run_opencl(kernel, rows, uniforms))
    expected, *others = run_each(runs, kernel)
    for values in others:
        for found, value in zip(values, expected, strict=True):
            np.testing.assert_allclose(found, value, rtol=rtol, atol=0, equal_nan=True)
