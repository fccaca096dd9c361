"""Runs a hand-built kernel on the reference backend and on cpu, on the same data."""

from __future__ import annotations

import numpy as np

from ebb.backends import reference
from ebb.backends.backend import CheckedKernel, Hints
from ebb.backends.cpu import cpu_backend
from ebb.compiler.kir_verify import verify_kernel
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.stencil import check_stencil, collect_stencil


def checked(kernel, fastmath=False):
    verify_kernel(kernel)
    return CheckedKernel(kernel, check_phases(kernel), collect_stencil(kernel), Hints(fastmath=fastmath))


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
            field.changed()


def run_cpu(kernel, rows=None, uniforms=(), threads=1):
    executable = cpu_backend(threads).prepare(checked(kernel))
    launch(executable, kernel, kernel.relation if rows is None else rows, uniforms)


def run_both(kernel, rows=None, uniforms=(), threads=2):
    """The values of the changed fields and globals on the reference and on cpu, from the same start."""
    rows = kernel.relation if rows is None else rows
    places = [field.data for field in changed_fields(kernel)]
    places += [globl.data for globl in check_phases(kernel).globals]
    before = [place.copy() for place in places]
    launch(reference.reference_backend().prepare(checked(kernel)), kernel, rows, uniforms)
    expected = [place.copy() for place in places]
    for place, value in zip(places, before, strict=True):
        place[...] = value
    for field in changed_fields(kernel):
        field.changed()
    run_cpu(kernel, rows, uniforms, threads)
    return expected, [place.copy() for place in places]


def assert_agree(kernel, rows=None, uniforms=(), threads=2, rtol=0.0):
    """The backends agree: bit for bit, or where ``rtol`` is given, up to that, NaN where NaN."""
    for expected, found in zip(*run_both(kernel, rows, uniforms, threads), strict=True):
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=0, equal_nan=True)
