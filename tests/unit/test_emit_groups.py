"""Kernels for groups of threads: what is emitted, and what it does on an OpenCL device."""

from __future__ import annotations

import math
import os
import re
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from lir_programs import Written, image_of, run

from ebb.backends import target
from ebb.backends.compile import assembly_text, llvm_text, needs
from ebb.backends.llvm.emit import emit
from ebb.backends.llvm.group import parameters
from ebb.backends.llvm.spirv_code import Untranslated, spirv_binary
from ebb.backends.llvm.spirv_passes import Untranslatable, check
from ebb.compiler import lir
from ebb.compiler.lower.builder import index, number
from ebb.errors import BackendError
from ebb.runtime.device import FAILURE_CAPACITY, Feature
from ebb.types.arithmetic import BINARY
from ebb.types.types import Kind, bool_, float32, float64, int32, int64, uint32, uint64

SCALARS = (bool_, int32, int64, uint32, uint64, float32, float64)
FLOATS = (float32, float64)
INTEGERS = (int32, int64, uint32, uint64)


def mapped(operands, type_, operation, result=None, **options):
    """The program that computes ``operation`` of what is in the slots, row by row."""
    w = Written(*[type_] * operands, result or type_)

    def row(at):
        values = tuple(w.load(k, at[0]) for k in range(operands))
        w.store(operands, at[0], w.b.let(operation(*values), result or type_))

    return w.program(row, **options)


def compute(program, dtype, *operands, lacks=frozenset()):
    result = np.zeros(len(operands[0]), dtype=dtype)
    run(program, [*operands, result], [(0, len(result))], lacks=lacks)
    return result


def ulps(actual, desired, dtype):
    """The distance in units in the last place of ``desired``, which is in more digits."""
    actual, desired = actual.astype(np.float64), desired.astype(np.float64)
    same = (actual == desired) | (np.isnan(actual) & np.isnan(desired))
    rounded = np.abs(desired.astype(dtype))
    unit = np.spacing(np.maximum(rounded, np.finfo(dtype).tiny)).astype(np.float64)
    with np.errstate(invalid="ignore"):
        return np.where(same | (actual == rounded * np.sign(desired)), 0.0, np.abs(actual - desired) / unit)


# ---- What is emitted ----


def axpy(scalar):
    w = Written(scalar, scalar)

    def row(at):
        w.store(1, at[0], w.b.binary("+", w.b.binary("*", w.load(0, at[0]), number(2.0, scalar)), number(1.0, scalar)))

    return w.program(row)


def test_a_kernel_takes_failures_blocks_the_box_and_slots():
    program = axpy(float32)
    names = [name for name, _ in parameters(program)]
    assert names == ["failures", "first_block", "first_row", "low0", "high0", "slot0", "slot1"]
    text = emit(program, target.spirv().hooks)
    assert "define spir_kernel void @ebb_test(ptr addrspace(1) noalias" in text
    assert "reqd_work_group_size !0" in text and "!{i32 64, i32 1, i32 1}" in text


def test_each_stage_of_spirv_is_shown():
    program = axpy(float32)
    assert "fmul contract float" in llvm_text(program, target.spirv())
    text = assembly_text(program, target.spirv())
    assert "OpEntryPoint Kernel" in text and "LocalSize 64 1 1" in text and "ContractionOff" not in text


def test_images_are_the_same_each_time():
    program = axpy(float64)
    assert len({image_of(program) for _ in range(5)}) == 1


def test_modules_are_of_the_oldest_version_of_spirv():
    assert list(np.frombuffer(image_of(axpy(float32)), dtype=np.uint32)[:2]) == [0x07230203, 0x00010000]


def all_of(scalar):
    """A program that does all that can be done to floats of one type."""
    w = Written(scalar, int32, scalar, writes=[2])

    def row(at):
        b, x, n = w.b, w.load(0, at[0]), w.load(1, at[0])
        total = b.convert(n, scalar)
        for function, operands in lir.MATH.items():
            if function != "ipow":
                total = b.binary("+", total, b.let(lir.Math(function, (x,) * operands), scalar))
        for op in ("-", "*", "/", "//", "%", "min", "max"):
            total = b.binary(op, total, x)
        for kind in INTEGERS:
            total = b.binary("+", total, b.convert(b.convert(x, kind), scalar))
        b.add(lir.AtomicUpdate(w.slots[2], index(0), "+", total))
        b.add(lir.AtomicUpdate(w.slots[2], index(1), "max", total))

    return w.program(row)


def test_a_float32_kernel_has_no_float64_instruction():
    program = all_of(float32)
    assert needs(program) == frozenset()
    for lacks in (frozenset(), frozenset({Feature.FLOAT32_ADD})):
        assert "double" not in llvm_text(program, target.spirv(lacks))
        assert not re.search(r"OpCapability Float64|OpTypeFloat 64", assembly_text(program, target.spirv(lacks)))


def test_what_a_program_needs_of_a_device():
    assert needs(all_of(float64)) == {Feature.FLOAT64, Feature.ATOMICS64}
    assert needs(axpy(float64)) == {Feature.FLOAT64}
    assert needs(axpy(float32)) == frozenset()


def test_an_addition_that_the_device_lacks_is_a_loop():
    def row_of(w):
        return lambda at: w.b.add(lir.AtomicUpdate(w.slots[1], index(0), "+", w.load(0, at[0])))

    for scalar, lacking in ((float32, Feature.FLOAT32_ADD), (float64, Feature.FLOAT64_ADD)):
        w = Written(scalar, scalar)
        program = w.program(row_of(w))
        assert "OpAtomicFAddEXT" in assembly_text(program, target.spirv())
        text = assembly_text(program, target.spirv(frozenset({lacking})))
        assert "OpAtomicCompareExchange" in text and "SPV_EXT" not in text


@pytest.mark.parametrize(
    "body", ["%y = add i37 %x, 1", "%v = insertelement <2 x i37> poison, i37 %x, i64 0", "%y = sext i37 %x to i128"]
)
def test_what_spirv_lacks_is_refused_before_it_is_translated(body):
    import llvmlite.binding as llvm

    module = llvm.parse_assembly(f"define spir_kernel void @k(i37 %x) {{\n  {body}\n  ret void\n}}")
    with pytest.raises(Untranslatable):
        check(module)


def test_an_abort_of_llvm_is_an_error_of_this_process():
    import llvmlite.binding as llvm

    target.spirv().machine  # sets LLVM up
    text = "define spir_kernel void @k(i128 %x, ptr %p) {\n  store i128 %x, ptr %p\n  ret void\n}"
    module = llvm.parse_assembly(text)
    module.triple = target.spirv().triple
    with pytest.raises(Untranslated, match="LLVM ERROR"):
        spirv_binary(module)
    assert image_of(axpy(float32))  # the next one is fine


def test_the_translator_is_started_again_where_it_has_ended():
    from ebb.backends.llvm import spirv_code

    first = image_of(axpy(float32))
    process = spirv_code._translator._process
    process.kill()
    process.wait()
    assert image_of(axpy(float32)) == first
    assert spirv_code._translator._process is not process


def test_threads_share_the_translator():
    programs = [axpy(scalar) for scalar in (float32, float64, int32, int64)]
    one_by_one = [image_of(program) for program in programs]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(image_of, programs * 3)) == one_by_one * 3


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_a_forked_process_has_a_translator_of_its_own():
    expected = image_of(axpy(float32))
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(writing, b"same" if image_of(axpy(float32)) == expected else b"other")
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    assert os.read(reading, 10) == b"same"
    os.close(reading)
    os.close(writing)
    assert image_of(axpy(float32)) == expected


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_a_process_ends_while_those_forked_from_it_go_on():
    from ebb.backends.llvm.spirv_code import _Translator

    translator = _Translator()
    translator._running()
    child = os.fork()
    if child == 0:
        signal.pause()
        os._exit(0)
    ended = threading.Thread(target=translator.end, daemon=True)
    ended.start()
    ended.join(30)
    hangs = ended.is_alive()
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert not hangs


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_a_process_that_is_forked_while_another_thread_asks_does_not_wait_for_it():
    from ebb.backends.llvm import spirv_code

    program = axpy(float32)
    with spirv_code._translator._lock:
        child = os.fork()
        if child == 0:
            signal.alarm(30)
            try:
                image_of(program)
                os._exit(0)
            finally:
                os._exit(1)
    assert os.waitpid(child, 0)[1] == 0


def test_an_end_of_the_translator_amid_a_request_is_an_error_and_the_next_is_fine(monkeypatch):
    from ebb.backends.llvm import spirv_code

    translator = spirv_code._Translator()
    monkeypatch.setattr(spirv_code, "_translator", translator)
    for request in (b"", bytes(1 << 20)):  # one that it gets, and one that it cannot get any more
        process = translator._running()
        monkeypatch.setattr(process, "poll", lambda: None)  # as if it ended after we have looked
        process.kill()
        process.wait()
        assert translator._ask(request) == (False, b"")
    assert image_of(axpy(float32))
    translator.end()


def test_where_there_is_no_fork_each_module_has_a_translator(monkeypatch):
    from ebb.backends.llvm import spirv_code

    translator = spirv_code._Translator()
    monkeypatch.setattr(spirv_code, "_translator", translator)
    monkeypatch.setattr(spirv_code, "FORKS", False)
    assert image_of(axpy(float32)) == image_of(axpy(float32))
    assert translator._process is None


@pytest.mark.parametrize("executable", ["/nowhere/python", "", None])
def test_where_no_python_can_be_started_that_is_said(monkeypatch, executable):
    from ebb.backends.llvm.spirv_code import _Translator

    monkeypatch.setattr("sys.executable", executable)
    with pytest.raises(BackendError, match="nowhere" if executable else "no Python"):
        _Translator()._running()


def test_a_program_that_carries_its_own_python_is_not_started_again(monkeypatch):
    from ebb.backends.llvm.spirv_code import _Translator

    monkeypatch.setattr("sys.frozen", True, raising=False)
    with pytest.raises(BackendError, match="no Python"):
        _Translator()._running()


def test_a_label_is_no_integer_type():
    import llvmlite.binding as llvm

    check(llvm.parse_assembly("define void @k() {\ni37.5:\n  br label %i37\n\ni37:\n  ret void\n}"))


# ---- Which rows run ----


@pytest.mark.parametrize("size", [1, 3, 64, 100, 1024])
def test_each_row_runs_once(size):
    w = Written(int64)
    program = w.program(lambda at: w.b.add(lir.AtomicUpdate(w.slots[0], at[0], "+", index(1))), group_size=size)
    for rows in (1, 63, 64, 65, 3000):
        counts = np.zeros(rows + 10, dtype=np.int64)
        run(program, [counts], [(0, rows)])
        assert (counts[:rows] == 1).all() and not counts[rows:].any()


@pytest.mark.parametrize("bounds", [[(2, 9)], [(1, 6), (3, 11)], [(0, 3), (2, 3), (5, 9)], [(1, 4), (0, 7), (2, 5)]])
@pytest.mark.parametrize("coverage", lir.Coverage)
def test_rows_of_a_box_have_their_coordinates(bounds, coverage):
    dimensions, extent = len(bounds), 12
    w = Written(int64)

    def row(at):
        place = at[0]
        for coordinate in at[1:]:
            place = w.b.add_index(w.b.scale_index(place, extent), coordinate)
        w.b.add(lir.AtomicUpdate(w.slots[0], place, "+", index(1)))

    program = w.program(row, group_size=32, dimensions=dimensions, space=lir.Space.BOX, coverage=coverage)
    counts = np.zeros((extent,) * dimensions, dtype=np.int64)
    run(program, [counts], bounds, groups=None if coverage is lir.Coverage.ONE else 2)
    expected = np.zeros_like(counts)
    expected[tuple(slice(*bound) for bound in bounds)] = 1
    np.testing.assert_array_equal(counts, expected)


def test_boxes_beyond_32_bits_are_divided_rightly():
    w = Written(int64)

    def row(at):
        for k in range(2):
            w.store(0, index(k), at[k])

    width = 2**33
    program = w.program(row, group_size=1, dimensions=2, space=lir.Space.BOX, coverage=lir.Coverage.STRIDED)
    last = np.zeros(2, dtype=np.int64)
    run(program, [last], [(5, 6), (7, 8)], groups=1)
    assert list(last) == [5, 7]
    w = Written(int64)
    program = w.program(row, group_size=4, dimensions=2, space=lir.Space.BOX)
    run(program, [last], [(0, 1), (width, width + 2)], groups=1)
    assert list(last) in ([0, width], [0, width + 1])
    wide = emit(program, target.spirv().hooks)
    assert "udiv i32" in wide and "udiv i64" in wide


@pytest.mark.parametrize("size", [1, 3, 64, 100, 1024])
@pytest.mark.parametrize("groups", [1, 7])
def test_strided_rows_are_summed_by_a_tree_with_barriers(size, groups):
    from ebb.compiler.lower.trees import Tree

    w, b = (written := Written(int32, int64)), written.b
    held = {}

    def before():
        held["sum"] = b.declare("sum", int64, 1)

    def row(at):
        b.add(lir.Accumulate(held["sum"], index(0), "+", b.convert(w.load(0, at[0]), int64)))

    def after():
        with Tree(b, size).combined("+", (held["sum"], 0)) as place:
            w.store(1, w.block_number, b.load_var(*place))

    program = w.program(row, size, coverage=lir.Coverage.STRIDED, before=before, after=after)
    rng = np.random.default_rng(size)
    for rows in (0, 1, 5000):
        numbers = rng.integers(-1000, 1000, size=rows + 1, dtype=np.int32)
        partials = np.full(groups, -1, dtype=np.int64)
        run(program, [numbers, partials], [(0, rows)], groups=groups)
        taken = np.arange(rows) // size % groups
        np.testing.assert_array_equal(partials, np.bincount(taken, numbers[:rows], minlength=groups).astype(np.int64))


def test_one_thread_takes_its_rows_in_order():
    w = Written(int64)

    def row(at):
        before = w.load(0, index(0))
        w.store(0, index(0), w.b.binary("+", w.b.binary("*", before, index(3)), at[0]))

    program = w.program(row, group_size=1, coverage=lir.Coverage.STRIDED)
    value = np.zeros(1, dtype=np.int64)
    run(program, [value], [(0, 30)], groups=1)
    expected = 0
    for k in range(30):
        expected = expected * 3 + k
    assert value[0] == np.int64(expected)


def test_bools_in_memory_of_the_group():
    w, b = (written := Written(bool_, bool_)), written.b

    def row(at):
        pass

    def after():
        thread = b.let(lir.ThreadNumber(), int64)
        shared = b.declare("shared", bool_, 64, lir.Memory.GROUP)
        b.add(lir.StoreVar(shared, thread, w.load(0, thread)))
        b.add(lir.Barrier())
        w.store(1, thread, b.load_var(shared, b.binary("-", index(63), thread)))

    flags = np.random.default_rng(0).random(64) < 0.5
    turned = np.zeros(64, dtype=bool)
    run(w.program(row, after=after), [flags, turned], [(0, 64)])
    np.testing.assert_array_equal(turned, flags[::-1])


# ---- Failures and prints ----


def failing(size=64, coverage=lir.Coverage.ONE, dimensions=1):
    """Rows fail where the first slot says so, then mark themselves in the second."""
    w, b = (written := Written(bool_, int32)), written.b
    space = lir.Space.LINE if dimensions == 1 else lir.Space.BOX

    def row(at):
        place = at[0] if dimensions == 1 else b.add_index(b.scale_index(at[0], 100), at[1])
        b.add(lir.If(w.load(0, place), (lir.Fail(1, place, (at[0], index(-7))),), ()))
        w.store(1, place, number(1, int32))

    return w.program(row, size, dimensions, space, coverage, sites=2)


def lowest(records, count):
    chosen = records[: min(count, FAILURE_CAPACITY)]
    return min(chosen.tolist())


@pytest.mark.parametrize("size", [1, 64, 100])
@pytest.mark.parametrize("coverage", lir.Coverage)
def test_the_lowest_row_that_fails_leaves_a_record(size, coverage):
    program = failing(size, coverage)
    rng = np.random.default_rng(size)
    for share in (0.5, 0.01, 1.0):
        fails = rng.random(100_000) < share
        marks = np.zeros(len(fails), dtype=np.int32)
        groups = None if coverage is lir.Coverage.ONE else 5
        records, count = run(program, [fails, marks], [(0, len(fails))], groups=groups)
        first = int(np.flatnonzero(fails)[0])
        assert count and lowest(records, count)[:5] == [first, first, 2, first, -7]
        assert not marks[fails].any()
        if coverage is lir.Coverage.ONE:
            assert marks[~fails].all()


def test_a_launch_without_failures_leaves_nothing():
    fails, marks = np.zeros(1000, dtype=bool), np.zeros(1000, dtype=np.int32)
    _, count = run(failing(), [fails, marks], [(0, 1000)])
    assert count == 0 and marks.all()


@pytest.mark.parametrize("coverage", lir.Coverage)
def test_rows_of_later_boxes_are_numbered_on(coverage):
    fails, marks = np.zeros((8, 100), dtype=bool), np.zeros((8, 100), dtype=np.int32)
    fails[3, 7] = True
    groups = None if coverage is lir.Coverage.ONE else 1
    box = [(2, 5), (4, 10)]
    records, count = run(failing(4, coverage, 2), [fails, marks], box, groups=groups, first_row=1000)
    assert count == 1 and lowest(records, count)[:3] == [1000 + 6 + 3, 307, 2]


def test_prints_are_counted_and_kept_where_there_is_room():
    w, b = (written := Written(float32, int64)), written.b
    slot = lir.Slot(1, int64, lir.Access.WRITE, lir.PrintRecords())
    w.slots[1] = slot
    words = lir.PRINT_HEADER + 2

    def row(at):
        b.add(lir.Print(0, slot, at[0], (w.load(0, at[0]), b.compare("<", at[0], index(5)))))

    program = w.program(row, prints=1, print_words=2)
    assert needs(program) == {Feature.ATOMICS64}
    numbers = np.arange(100, dtype=np.float32) / 4
    for capacity in (200, 10):
        memory = np.zeros(lir.PRINT_RECORDS + words * 200, dtype=np.int64)
        memory[lir.PRINT_CAPACITY] = capacity
        run(program, [numbers, memory], [(0, 100)])
        assert memory[lir.PRINT_COUNTER] == 100
        records = memory[lir.PRINT_RECORDS :].reshape(-1, words)
        kept = records[: min(100, capacity)]
        assert not records[len(kept) :].any()
        at = kept[:, 1]
        assert len(set(at)) == len(at) and not kept[:, 0].any()
        np.testing.assert_array_equal(kept[:, 2].astype(np.uint32).view(np.float32), numbers[at])
        np.testing.assert_array_equal(kept[:, 3], at < 5)


# ---- Atomic updates ----

_REDUCED = {
    "+": np.add, "*": np.multiply, "min": np.minimum, "max": np.maximum,
    "&": np.bitwise_and, "|": np.bitwise_or, "^": np.bitwise_xor,
}  # fmt: skip


def operators(scalar):
    match scalar.kind:
        case Kind.BOOL:
            return ("&", "|", "^")
        case Kind.FLOAT:
            return ("+", "*", "min", "max")
        case _:
            return tuple(_REDUCED)


@pytest.mark.parametrize(
    ("scalar", "op"), [(s, op) for s in SCALARS for op in operators(s)], ids=lambda x: getattr(x, "name", x)
)
def test_atomic_updates_lose_nothing(scalar, op):
    w = Written(scalar, scalar)
    targets, rows = 7, 20_000  # bools: neighbours in one word

    def row(at):
        place = w.b.binary("%", at[0], index(targets))
        w.b.add(lir.AtomicUpdate(w.slots[1], place, op, w.load(0, at[0])))

    program, rng = w.program(row), np.random.default_rng(3)
    if scalar.kind is Kind.BOOL:
        values, start = rng.random(rows) < {"&": 0.9999, "|": 0.0001, "^": 0.5}[op], rng.random(targets) < 0.5
    elif scalar.kind is Kind.FLOAT:
        # Sums and products of these are exact.
        values = np.exp2(rng.integers(0, 2, rows) * 2 - 1) if op == "*" else rng.integers(-50, 50, rows) / 4
        start = np.ones(targets)
    else:
        values, start = rng.integers(-(2**31), 2**31, rows), np.full(targets, 5)
    values, start = (np.asarray(x).astype(scalar.dtype) for x in (values, start))
    if op == "*" and scalar.kind is Kind.FLOAT:
        values[::2] = values[1::2] ** -1
    expected = start.copy()
    with np.errstate(over="ignore"):
        _REDUCED[op].at(expected, np.arange(rows) % targets, values)
    for lacks in (frozenset(), frozenset({Feature.FLOAT32_ADD, Feature.FLOAT64_ADD})):
        actual = start.copy()
        run(program, [values, actual], [(0, rows)], lacks=lacks)
        np.testing.assert_array_equal(actual, expected)


@pytest.mark.parametrize("op", ["min", "max"])
@pytest.mark.parametrize("scalar", FLOATS)
def test_atomic_extrema_keep_nan(scalar, op):
    w = Written(scalar, scalar)
    program = w.program(lambda at: w.b.add(lir.AtomicUpdate(w.slots[1], index(0), op, w.load(0, at[0]))))
    values = np.arange(500, dtype=scalar.dtype)
    values[77] = np.nan
    result = np.zeros(1, dtype=scalar.dtype)
    run(program, [values, result], [(0, 500)])
    assert np.isnan(result[0])


# ---- Operations ----

SPECIAL = (0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 1.5, 2.5, -2.5, 1e-3, 3.7, -3.7, 1e6, np.inf, -np.inf, np.nan)


@pytest.mark.parametrize("source", FLOATS)
@pytest.mark.parametrize("goal", INTEGERS)
def test_floats_to_integers_saturate(source, goal):
    limits = np.iinfo(goal.dtype)
    wanted = [*SPECIAL, 2.0**31, -(2.0**31), 2.0**32, 2.0**63, -(2.0**63), 2.0**64, 1e30, -1e30]
    values = np.array(wanted, dtype=source.dtype)
    values = np.concatenate([values, np.nextafter(values, source.dtype.type(0)), np.nextafter(values, np.inf)])
    program = mapped(1, source, lambda x: lir.Convert(x), goal)
    expected = [
        0 if math.isnan(v) else limits.max if v >= limits.max else limits.min if v <= limits.min else int(v)
        for v in values.tolist()
    ]
    np.testing.assert_array_equal(compute(program, goal.dtype, values), np.array(expected, dtype=goal.dtype))


@pytest.mark.parametrize("op", ["min", "max", "//", "%"])
@pytest.mark.parametrize("scalar", FLOATS)
def test_irregular_operators_on_floats_are_those_of_numpy(scalar, op):
    pairs = np.array([(a, b) for a in SPECIAL for b in SPECIAL], dtype=scalar.dtype)
    a, b = np.ascontiguousarray(pairs.T)
    function = {"min": np.minimum, "max": np.maximum, "//": np.floor_divide, "%": np.remainder}[op]
    with np.errstate(all="ignore"):
        expected = function(a, b)
    program = mapped(2, scalar, lambda x, y: lir.Binary(op, x, y))
    np.testing.assert_array_equal(compute(program, scalar.dtype, a, b), expected)


@pytest.mark.parametrize("op", ["+", "-", "*", "//", "%", "<<", ">>", "min", "max", "ipow"])
@pytest.mark.parametrize("scalar", INTEGERS)
def test_integer_operators_are_total(scalar, op):
    limits = np.iinfo(scalar.dtype)
    edges = [0, 1, 2, 3, 7, 31, 32, 63, 64, 100, limits.max, limits.max - 1, limits.min, limits.min + 1]
    if scalar.kind is Kind.SIGNED:
        edges += [-1, -2, -3, -7, -64]
    pairs = np.array([(a, b) for a in edges for b in edges], dtype=scalar.dtype)
    a, b = np.ascontiguousarray(pairs.T)
    if op == "ipow":
        program = mapped(2, scalar, lambda x, y: lir.Math("ipow", (x, y)))
    else:
        program = mapped(2, scalar, lambda x, y: lir.Binary(op, x, y))
    with np.errstate(all="ignore"):
        expected = BINARY["**" if op == "ipow" else op](a, b)
    np.testing.assert_array_equal(compute(program, scalar.dtype, a, b), expected)


def reference(function):
    """``function`` on float64."""
    renamed = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "asinh": "arcsinh", "acosh": "arccosh",
               "atanh": "arctanh", "round": "rint", "pow": "power", "atan2": "arctan2"}  # fmt: skip
    name = renamed.get(function, function)
    if hasattr(np, name):
        return getattr(np, name)
    return np.vectorize(getattr(math, function), otypes=[np.float64])


# Units in the last place, as OpenCL demands of devices of the full profile; those that are not listed are exact.
LIMITS = {
    "sqrt": 3, "cbrt": 2, "exp": 3, "log": 3, "log2": 3, "log10": 3, "exp2": 3, "expm1": 3, "log1p": 2, "sin": 4,
    "cos": 4, "tan": 5, "asin": 4, "acos": 4, "atan": 5, "sinh": 4, "cosh": 4, "tanh": 5, "asinh": 4, "acosh": 4,
    "atanh": 5, "erf": 16, "erfc": 16, "gamma": 16, "pow": 16, "atan2": 6, "hypot": 4,
}  # fmt: skip
POSITIVE = {"sqrt", "log", "log2", "log10", "gamma", "lgamma", "pow"}
RANGES = {
    "asin": (-1, 1), "acos": (-1, 1), "atanh": (-0.999, 0.999), "acosh": (1, 50), "log1p": (-0.999, 50),
    "gamma": (0.01, 30), "exp": (-80, 80), "exp2": (-100, 100), "sinh": (-80, 80), "cosh": (-80, 80),
    "erfc": (-5, 5),
}  # fmt: skip


@pytest.mark.parametrize("function", [name for name in lir.MATH if name != "ipow"])
@pytest.mark.parametrize("scalar", FLOATS)
def test_functions_agree_with_numpy(scalar, function):
    operands = lir.MATH[function]
    low, high = RANGES.get(function, (1e-3 if function in POSITIVE else -20, 20))
    rng = np.random.default_rng(len(function))
    values = [rng.uniform(low, high, 4000).astype(scalar.dtype) for _ in range(operands)]
    program = mapped(operands, scalar, lambda *x: lir.Math(function, x))
    actual = compute(program, scalar.dtype, *values)
    expected = reference(function)(*(value.astype(np.float64) for value in values))
    if function == "lgamma":  # OpenCL promises nothing: near its zeros the error is absolute
        np.testing.assert_allclose(actual, expected, rtol=1e-5 if scalar is float32 else 1e-13, atol=1e-6)
        return
    # NumPy's own error is up to one unit in float64.
    assert ulps(actual, expected, scalar.dtype).max() <= LIMITS.get(function, 0) + (1 if scalar is float64 else 0.5)


EXACT_AT_SPECIALS = ("abs", "sqrt", "floor", "ceil", "trunc", "round", "copysign", "fmod", "exp", "log", "atan", "tanh")


@pytest.mark.parametrize("function", EXACT_AT_SPECIALS)
@pytest.mark.parametrize("scalar", FLOATS)
def test_functions_agree_with_numpy_at_special_values(scalar, function):
    operands = lir.MATH[function]
    pairs = np.array([(a, b) for a in SPECIAL for b in SPECIAL], dtype=scalar.dtype)
    values = list(np.ascontiguousarray(pairs.T))[:operands]
    program = mapped(operands, scalar, lambda *x: lir.Math(function, x))
    actual = compute(program, scalar.dtype, *values)
    with np.errstate(all="ignore"):
        expected = reference(function)(*(value.astype(np.float64) for value in values))
        assert (ulps(actual, expected.astype(scalar.dtype), scalar.dtype) <= 4).all()
