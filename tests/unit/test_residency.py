"""Copies on devices: what is moved, and when, and that whoever looks sees what was written last."""

from __future__ import annotations

import gc
import sys
import threading
from contextlib import contextmanager
from functools import partial
from linecache import getline

import numpy as np
import pytest

import ebb
from ebb.relations.family import family_of
from ebb.runtime import copies
from ebb.runtime.buffer import Buffer, Layout
from ebb.runtime.copies import constant_on, constant_states
from ebb.runtime.epoch import structure
from ebb.runtime.threads import launching
from fake_device import FakeDevice, run_on

SIZE = 100
BYTES = 4 * SIZE
UP, DOWN = ("up", BYTES), ("down", BYTES)


@pytest.fixture
def device():
    return FakeDevice()


@pytest.fixture(params=["cpu", "reference"])
def backend(request):
    with ebb.backend(request.param):
        yield request.param


@pytest.fixture
def rows():
    rows = ebb.Relation("rows", size=SIZE)
    for name in ("a", "b", "c"):
        rows.new_field(name, ebb.float32)
    rows.a.load(np.arange(SIZE))
    return rows


@pytest.fixture
def add(rows, backend):
    @ebb.kernel
    def add(row: rows):
        row.c = row.b + 1

    return add


def double(source, target):
    target[...] = 2 * source


def increase(values):
    values += 1


def numbers(field):
    return field.to_numpy().tolist()


TWICE = [2.0 * number for number in range(SIZE)]


# What is moved


def test_exactly_what_is_needed_is_moved(device, rows, add) -> None:
    run_on(device, double, rows.a, overwritten=[rows.b])
    assert device.taken_moves() == [UP]
    assert numbers(rows.b) == TWICE
    assert device.taken_moves() == [DOWN]
    assert numbers(rows.b) == TWICE
    add(rows)
    assert numbers(rows.c) == [number + 1 for number in TWICE]
    run_on(device, double, rows.b, overwritten=[rows.c])
    assert device.taken_moves() == []
    rows.a.load(1)
    run_on(device, double, rows.a, overwritten=[rows.b])
    assert device.taken_moves() == [UP]
    assert numbers(rows.b) == [2.0] * SIZE
    assert numbers(rows.c) == [4 * number for number in range(SIZE)]
    assert device.taken_moves() == [DOWN, DOWN]


def test_nothing_runs_before_somebody_looks(device, rows) -> None:
    ran = []
    run_on(device, lambda values: ran.append(increase(values)), changed=[rows.a])
    run_on(device, increase, changed=[rows.a])
    assert (ran, device.launched) == ([], 2)
    assert rows.a.data[0] == 2
    assert ran == [None]


def test_a_kernel_on_the_processor_takes_its_fields_from_the_device(device, rows, add) -> None:
    for turn in range(12):  # the first launches all settle, the others take the fast path
        run_on(device, increase, changed=[rows.b])
        add(rows)
        assert device.taken_moves() == ([UP] if turn == 0 else []) + [DOWN]
        assert rows.c.data.tolist() == [turn + 2.0] * SIZE


def test_what_a_kernel_on_the_processor_writes_is_taken_to_the_device(device, rows, add) -> None:
    for turn in range(12):
        rows.b.fill(turn)
        add(rows)
        run_on(device, increase, changed=[rows.c])
        assert device.taken_moves() == [UP]
        assert rows.c.data.tolist() == [turn + 2.0] * SIZE
        assert device.taken_moves() == [DOWN]


def test_a_settled_kernel_notices_a_copy_that_is_only_read(device, rows, add) -> None:
    for _ in range(12):
        add(rows)
    run_on(device, lambda values: None, rows.c)
    rows.b.load(7)
    add(rows)
    found = []
    run_on(device, lambda values: found.append(values.copy()), rows.c)
    device.wait()
    assert found[0].tolist() == [8.0] * SIZE


def test_what_a_launch_on_some_rows_writes_is_uploaded_first(device, rows) -> None:
    run_on(device, lambda values: values.__setitem__(slice(3), -1), changed=[rows.a])
    assert device.taken_moves() == [UP]
    assert numbers(rows.a)[:5] == [-1, -1, -1, 3, 4]


def test_a_swap_moves_nothing(device, rows) -> None:
    run_on(device, double, rows.a, overwritten=[rows.b])
    device.taken_moves()
    for _ in range(3):
        rows.swap("a", "b")
        run_on(device, double, rows.a, overwritten=[rows.b])
    assert device.taken_moves() == []
    assert numbers(rows.b) == [16.0 * number for number in range(SIZE)]
    assert numbers(rows.a) == [8.0 * number for number in range(SIZE)]
    assert device.taken_moves() == [DOWN, DOWN]


def test_a_settled_kernel_notices_a_swap_with_what_a_device_has(device, rows, add) -> None:
    for _ in range(12):
        add(rows)
    run_on(device, double, rows.a, overwritten=[rows.a])
    for _ in range(12):
        add(rows)
    rows.swap("a", "b")
    add(rows)
    assert numbers(rows.c) == [number + 1 for number in TWICE]


def test_a_settled_kernel_notices_a_swap_with_what_a_device_has_too(device, rows, add) -> None:
    run_on(device, lambda values: None, rows.a)
    for _ in range(12):
        add(rows)
    rows.swap("a", "c")
    add(rows)  # writes what the device has a copy of
    found = []
    run_on(device, lambda values: found.append(values.copy()), rows.c)
    assert numbers(rows.c) == [1.0] * SIZE
    device.wait()
    assert found[0].tolist() == [1.0] * SIZE


def test_launches_on_a_device_leave_the_structure_as_it_is(device, rows, add) -> None:
    run_on(device, double, rows.a, overwritten=[rows.b])
    epoch = structure.epoch
    for _ in range(3):
        rows.a.load(1)
        run_on(device, double, rows.a, overwritten=[rows.b])
        rows.swap("a", "b")
        numbers(rows.a)
    assert structure.epoch is epoch


def test_a_field_with_no_rows_moves_nothing(device) -> None:
    nothing = ebb.Relation("nothing", size=0)
    nothing.new_field("x", ebb.vec3f)
    nothing.new_field("k", nothing)
    run_on(device, lambda x, k: None, nothing.x, changed=[nothing.k])
    assert (nothing.x.to_numpy().shape, nothing.k.to_numpy().shape) == ((0, 3), (0,))
    assert device.taken_moves() == []
    assert not nothing.k.maybe_unset


def test_two_devices_hand_over_by_way_of_the_host(rows) -> None:
    first, second = FakeDevice("first"), FakeDevice("second")
    run_on(first, increase, changed=[rows.a])
    run_on(second, increase, changed=[rows.a])
    assert (first.taken_moves(), second.taken_moves()) == ([UP, DOWN], [UP])
    run_on(first, increase, changed=[rows.a])
    assert (first.taken_moves(), second.taken_moves()) == ([UP], [DOWN])
    assert rows.a.data[0] == 3


# The ways in which the host looks and writes


@pytest.mark.parametrize(
    "look",
    [
        lambda field: field.to_numpy(),
        lambda field: field.view(),
        lambda field: np.asarray(field),
        lambda field: np.from_dlpack(field),
        lambda field: field.data,
    ],
    ids=["to_numpy", "view", "array", "dlpack", "data"],
)
def test_whoever_looks_sees_what_a_device_wrote(device, rows, look) -> None:
    run_on(device, double, rows.a, overwritten=[rows.b])
    assert look(rows.b).tolist() == TWICE
    assert device.taken_moves() == [UP, DOWN]
    run_on(device, double, rows.b, overwritten=[rows.a])
    assert look(rows.a).tolist() == [2 * number for number in TWICE]
    assert device.taken_moves() == [DOWN]


def test_what_only_describes_a_field_moves_nothing(device, rows) -> None:
    run_on(device, increase, changed=[rows.a])
    device.taken_moves()
    assert repr(rows.a) and repr(rows) and len(rows)
    assert rows.a.__dlpack_device__() == (1, 0)
    assert (rows.a.buffer.shape, rows.a.buffer.nbytes, rows.a.buffer.strides) == ((SIZE,), BYTES, (4,))
    assert device.taken_moves() == []


def test_a_load_does_not_download(device, rows) -> None:
    run_on(device, increase, changed=[rows.a])
    device.taken_moves()
    rows.a.load(5)
    assert rows.a.data.tolist() == [5.0] * SIZE
    run_on(device, increase, changed=[rows.a])
    rows.a.load(rows.b)
    assert rows.a.data.tolist() == [0.0] * SIZE
    assert device.taken_moves() == [UP]


def test_a_field_is_loaded_from_one_that_lies_on_a_device(device, rows) -> None:
    run_on(device, increase, changed=[rows.a])
    rows.copy("a", "b")
    assert numbers(rows.b) == [number + 1.0 for number in range(SIZE)]
    run_on(device, increase, changed=[rows.b])
    rows.b.load(rows.b)
    assert numbers(rows.b) == [number + 2.0 for number in range(SIZE)]


def test_a_writable_view_is_of_the_host_alone(device, rows) -> None:
    run_on(device, increase, changed=[rows.a])
    with rows.a.view(write=True) as view:
        assert view[0] == 1
        assert rows.a.buffer.is_only_on_host
        view[0] = 10
    run_on(device, increase, changed=[rows.a])
    assert rows.a.data[:2].tolist() == [11, 3]


def test_globals_move_as_fields_do(device, rows, backend) -> None:
    total = ebb.Global(ebb.float32, 1.5)

    @ebb.kernel
    def add_up(row: rows):
        total.value += row.b

    run_on(device, increase, changed=[total])
    assert device.taken_moves() == [("up", 4)]
    assert total.value == 2.5
    for turn in range(12):
        run_on(device, increase, changed=[total])
        add_up(rows)
        run_on(device, increase, changed=[total])
        assert float(np.asarray(total)) == 2 * turn + 4.5
        total.value = total.value
    run_on(device, increase, changed=[total])
    device.taken_moves()
    total.value = 3
    assert (total.value, device.taken_moves()) == (3, [])
    assert repr(total) == "Global(float32, 3.0)"


# Order and layout


def test_rows_that_lie_on_a_device_are_permuted(device, rows) -> None:
    rows.new_field("next", rows, init=np.roll(np.arange(SIZE), 1))
    run_on(device, double, rows.a, overwritten=[rows.b])
    run_on(device, lambda keys: keys.__setitem__(slice(None), np.arange(SIZE)[::-1]), overwritten=[rows.next])
    rows.permute(np.roll(np.arange(SIZE), 7))
    assert numbers(rows.b) == TWICE
    assert numbers(rows.next) == list(range(SIZE))[::-1]
    run_on(device, increase, changed=[rows.b])
    assert numbers(rows.b) == [number + 1 for number in TWICE]


def test_keys_that_a_device_wrote_are_grouped(device, rows, backend) -> None:
    targets = ebb.Relation("targets", size=3)
    targets.new_field("count", ebb.int32)
    rows.new_field("key", targets, init=0)
    rows.group_by("key")

    @ebb.kernel
    def count(t: targets):
        n = 0
        for _ in ebb.where(rows.key, t):
            n += 1
        t.count = n

    for turn in range(12):
        run_on(device, lambda keys, turn=turn: np.copyto(keys, np.arange(SIZE) % (1 + turn % 3)), changed=[rows.key])
        count(targets)
        assert numbers(targets.count) == np.bincount(rows.key.to_numpy(), minlength=3).tolist()
        assert max(rows.key.to_numpy()) == turn % 3


@pytest.mark.parametrize("layout", Layout)
def test_another_layout_moves_with_its_values(device, layout) -> None:
    rows = ebb.Relation("rows", size=SIZE)
    values = np.random.default_rng(1).random((SIZE, 3, 3), np.float32)
    field = rows.new_field("m", ebb.mat3f, values)
    for chosen in (layout, *Layout):
        run_on(device, increase, changed=[field])
        values = values + 1
        family_of(field).layout = chosen
        family_of(field).convert(field)
        assert np.array_equal(field.to_numpy(), values)
    run_on(device, increase, changed=[field])
    assert np.array_equal(field.to_numpy(), values + 1)


def test_only_the_host_finds_out_whether_keys_are_unset(device, rows) -> None:
    keys = rows.new_field("key", rows)
    run_on(device, lambda keys: keys.__setitem__(..., 0), overwritten=[keys])
    assert keys.maybe_unset  # as far as is known without a download
    assert device.taken_moves() == []
    assert numbers(keys) == [0] * SIZE
    assert not keys.maybe_unset
    run_on(device, lambda keys: keys.__setitem__(..., 1), overwritten=[keys])
    assert not keys.maybe_unset
    keys.load(np.ma.masked_equal(np.arange(SIZE), 3))
    assert keys.maybe_unset


def test_no_key_is_unset_where_a_kernel_has_written_all(device, rows, backend) -> None:
    keys = rows.new_field("key", rows)
    rows.new_subset("most", np.s_[1:])

    @ebb.kernel
    def refer(row: rows):
        row.key = row

    @ebb.kernel
    def refer_if(row: rows):
        assert row.a < 50
        row.key = row

    refer(rows.most)
    run_on(device, lambda keys: None, changed=[keys])
    assert keys.maybe_unset
    with pytest.raises(ebb.KernelAssertionError):
        refer_if(rows)
    run_on(device, lambda keys: None, changed=[keys])
    assert keys.maybe_unset
    refer(rows)
    run_on(device, lambda keys: None, changed=[keys])
    device.taken_moves()
    assert not keys.maybe_unset
    assert device.taken_moves() == []


# Captured steps


@pytest.mark.parametrize("swapped", [False, True])
def test_a_captured_step_takes_its_fields_from_the_device(device, rows, swapped: bool) -> None:
    total = ebb.Global(ebb.float32, 0)

    @ebb.kernel
    def step(row: rows):
        row.b = 2 * row.a
        total.value += row.b

    with ebb.capture() as captured:
        total.value = 1
        step(rows)
        if swapped:
            rows.swap("a", "b")
    model_a, model_b = np.arange(SIZE, dtype=np.float32), np.zeros(SIZE, np.float32)
    for turn in range(6):
        run_on(device, increase, changed=[rows.a])
        run_on(device, increase, changed=[rows.b])
        run_on(device, increase, changed=[total])
        captured.run(2)
        model_a, model_b = model_a + 1, model_b + 1
        for _ in range(2):
            model_b = 2 * model_a
            expected = 1 + model_b.sum()
            if swapped:
                model_a, model_b = model_b, model_a
        assert total.value == pytest.approx(expected, rel=1e-5), turn
        run_on(device, increase, changed=[rows.b])
        model_b = model_b + 1
        assert (numbers(rows.a), numbers(rows.b)) == (model_a.tolist(), model_b.tolist())


# Failures


@pytest.mark.parametrize("error", [MemoryError("full"), KeyboardInterrupt()], ids=["error", "interrupt"])
def test_an_upload_that_fails_leaves_what_was(device, rows, error) -> None:
    for _ in range(2):  # when memory is taken, and when it is there
        device.failure = error
        with pytest.raises(type(error)):
            run_on(device, increase, changed=[rows.a])
        device.allocate(1)
        with pytest.raises(KeyError):
            rows.a.buffer.changed_on(FakeDevice())
        rows.a.buffer.on(device, overwritten=True)
        assert rows.a.buffer.is_only_on_host
    run_on(device, increase, changed=[rows.a])
    assert numbers(rows.a) == [number + 1.0 for number in range(SIZE)]


@pytest.mark.parametrize("error", [MemoryError("lost"), KeyboardInterrupt()], ids=["error", "interrupt"])
@pytest.mark.parametrize(
    "look", [lambda rows: rows.a.data, lambda rows: rows.permute(range(SIZE)[::-1]), lambda rows: rows.copy("a", "b")]
)
def test_a_download_that_fails_leaves_what_was(device, rows, error, look) -> None:
    run_on(device, increase, changed=[rows.a])
    device.failure = error
    with pytest.raises(type(error)):
        look(rows)
    assert not rows.a.buffer.is_current
    assert numbers(rows.b) == [0.0] * SIZE
    assert numbers(rows.a) == [number + 1.0 for number in range(SIZE)]


@pytest.mark.parametrize("there", [False, True], ids=["not there", "there"])
def test_an_interrupt_before_the_account_of_an_overwriting_launch(device, rows, there: bool) -> None:
    if there:
        run_on(device, lambda values: None, rows.a)
    with pytest.raises(KeyboardInterrupt), launching():
        memory = rows.a.buffer.on(device, overwritten=True)
        device.launch(lambda: memory.values(rows.a.buffer).fill(5), 1, 1, ())
        raise KeyboardInterrupt
    seen = numbers(rows.a)
    assert seen == ([5.0] * SIZE if there else list(range(SIZE)))
    run_on(device, double, rows.a, overwritten=[rows.b])
    assert numbers(rows.b) == [2 * value for value in seen]


@contextmanager
def interrupted_at(line: int):
    """Raises KeyboardInterrupt at the given line, counted from 1, that runs in the module of copies.

    Not at the end of a ``with``, where Python takes notice of no interrupt: it comes here as a line.
    """
    left = line

    def trace(frame, event, _):
        nonlocal left
        if frame.f_code.co_filename != copies.__file__:
            return None
        left -= event == "line" and "with " not in getline(copies.__file__, frame.f_lineno)
        if left == 0:
            left = -1
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)


@pytest.mark.parametrize("write", ["on the host", "on a device"])
def test_whenever_an_interrupt_comes_all_valid_copies_are_the_same(device, rows, write: str) -> None:
    other = FakeDevice()
    for line in range(1, 60):
        run_on(other, increase, changed=[rows.a])
        before = numbers(rows.a)
        run_on(device, increase, changed=[rows.b])
        run_on(other, double, rows.a, overwritten=[rows.c])
        try:
            with interrupted_at(line):
                if write == "on the host":
                    rows.a.buffer.overwrite(line)
                    rows.c.buffer.overwrite(line)
                else:
                    for field in (rows.a, rows.c):
                        run_on(device, partial(np.copyto, src=line), overwritten=[field])
        except KeyboardInterrupt:
            pass
        for field, old in ((rows.a, before), (rows.c, [2 * value for value in before])):
            seen = [memory_of(field, each) for each in (device, other)]
            found = [values for values in seen if values is not None]
            if field.buffer.is_current or not found:
                found.append(numbers(field))
            assert all(values == found[0] for values in found)
            assert found[0] in (old, [float(line)] * SIZE)


def memory_of(field, device):
    """The values of a valid copy; None where there is none."""
    copy = field.buffer.copies._on_devices.get(device)
    if copy is None or not copy.valid:
        return None
    device.wait()
    return copy.memory.values(field.buffer).tolist()


def test_a_launch_that_cannot_have_its_fields_does_not_run(device, rows, add) -> None:
    add(rows)
    run_on(device, increase, changed=[rows.b])
    device.failure = MemoryError("lost")
    with pytest.raises(MemoryError):
        add(rows)
    assert numbers(rows.c) == [1.0] * SIZE
    add(rows)
    assert numbers(rows.c) == [2.0] * SIZE


def test_an_interrupted_load_leaves_the_values_of_a_device(device, rows, monkeypatch) -> None:
    run_on(device, increase, changed=[rows.a])

    class Interrupting:
        def __array__(self, *_, **__):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rows.a.buffer.overwrite(Interrupting())
    assert numbers(rows.a) == [number + 1.0 for number in range(SIZE)]


def test_threads_that_look_at_once_download_once(device, rows) -> None:
    for _ in range(20):
        run_on(device, increase, changed=[rows.a])
        barrier, found = threading.Barrier(4), []

        def look(barrier=barrier, found=found):
            barrier.wait()
            found.append(rows.a.to_numpy()[0])

        threads = [threading.Thread(target=look) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(set(found)) == 1
        assert device.taken_moves()[-2:].count(DOWN) == 1


def test_a_launch_does_not_come_between_a_download_and_the_account_of_it(device, rows, monkeypatch) -> None:
    run_on(device, increase, changed=[rows.a])
    launched, usual = threading.Event(), device.download

    def launch():
        run_on(device, increase, changed=[rows.a])
        launched.set()

    def slow(source, target):
        usual(source, target)
        other.start()
        launched.wait(0.1)

    other = threading.Thread(target=launch)
    monkeypatch.setattr(device, "download", slow)
    rows.a.to_numpy()
    other.join()
    monkeypatch.undo()
    assert rows.a.to_numpy()[0] == 2


def test_loads_and_launches_of_several_threads_leave_a_true_state(rows) -> None:
    device, stop = FakeDevice(), threading.Event()

    def look():
        while not stop.is_set():
            rows.a.to_numpy()
            ebb.memory()

    reader = threading.Thread(target=look)
    reader.start()
    try:
        for number in range(300):
            rows.a.load(number)
            run_on(device, increase, changed=[rows.a])
            assert rows.a.data.tolist() == [number + 1.0] * SIZE
            rows.a.load(-number)
            assert rows.a.data.tolist() == [-number] * SIZE
    finally:
        stop.set()
        reader.join()


# Memory shared, and arrays that do not change


def test_a_buffer_seen_in_another_shape_has_the_same_copies(device) -> None:
    buffer = Buffer((6, 2), np.dtype(np.float64))
    flat = buffer.reshaped((12,))
    memory = buffer.on(device)
    assert flat.on(device) is memory and flat.address == buffer.address
    flat.changed_on(device)
    device.wait()
    memory.values(flat)[:] = 3
    assert buffer.host.tolist() == [[3, 3]] * 6


def test_memory_is_taken_in_whole_lines(device) -> None:
    assert Buffer((), np.dtype(np.bool_)).on(device).nbytes == 64
    assert Buffer((0, 3), np.dtype(np.float32)).on(device).nbytes == 64
    assert Buffer((17,), np.dtype(np.float32)).on(device).nbytes == 128


@pytest.mark.parametrize("array", [np.arange(20), np.arange(40)[::2], np.zeros(0, np.int32)], ids=str)
def test_arrays_that_do_not_change_are_uploaded_once(device, array) -> None:
    array = array[:]
    memory = constant_on(device, array)
    device.wait()
    assert constant_on(device, array) is memory
    assert memory.bytes[: array.nbytes].tobytes() == array.tobytes()
    assert device.taken_moves() == ([("up", array.nbytes)] if array.size else [])
    assert [state.nbytes for state in constant_states(array)] == [memory.nbytes]
    other = FakeDevice("other")
    assert constant_on(other, array) is not memory


def test_the_copies_of_an_array_go_with_it(device) -> None:
    array = np.arange(5)
    number = id(array)
    constant_on(device, array)
    del array
    gc.collect()
    from ebb.runtime import copies

    assert number not in copies._constants


# The report


def entries(report):
    return {entry.name: entry for entry in report.entries}


def test_memory_tells_of_every_copy(rows) -> None:
    device = FakeDevice("told of")
    before = ebb.memory()
    run_on(device, double, rows.a, overwritten=[rows.b])
    report = ebb.memory()
    found = entries(report)
    a, b = found["rows.a"], found["rows.b"]
    assert (a.type, a.rows, a.host_bytes, a.host_valid) == ("float32", SIZE, BYTES, True)
    assert [(copy.device, copy.nbytes, copy.valid) for copy in a.devices] == [("told of", 448, True)]
    assert (b.host_valid, b.devices[0].valid, found["rows.c"].devices) == (False, True, ())
    assert report.device_bytes["told of"] == 896
    assert report.host_bytes == sum(entry.host_bytes for entry in report.entries) >= 3 * BYTES
    assert (report.uploads - before.uploads, report.uploaded_bytes - before.uploaded_bytes) == (1, BYTES)
    assert report.downloads == before.downloads
    assert device.taken_moves() == [UP]
    rows.b.to_numpy()
    after = ebb.memory()
    assert (after.downloads - before.downloads, after.downloaded_bytes - before.downloaded_bytes) == (1, BYTES)


def test_memory_tells_of_indexes(device) -> None:
    targets, sources = ebb.Relation("targets", size=3), ebb.Relation("sources", size=5)
    sources.new_field("key", targets, init=[2, 1, 0, 1, 2])
    sources.new_field("other", targets, init=[2, 1, 0, 1, 2])
    sources.group_by("key")
    sources.group_by("other")
    sources.new_subset("some", [0, 3])
    sources.some.row_positions()
    constant_on(device, sources.key.grouping.offsets)
    found = entries(ebb.memory())
    assert (found["sources.key offsets"].rows, found["sources.key offsets"].host_bytes) == (4, 16)
    assert [copy.device for copy in found["sources.key offsets"].devices] == ["fake"]
    assert {"sources order", "sources rank", "sources.some rows"} < set(found)
    assert "sources.key rows" not in found


def test_memory_prints_a_table() -> None:
    device = FakeDevice("printed")
    rows = ebb.Relation("table_rows", size=1000)
    rows.new_field("pos", ebb.vec3f)
    rows.new_field("mass", ebb.float64)
    run_on(device, lambda _: None, overwritten=[rows.pos])
    text = str(ebb.memory())
    assert repr(ebb.memory()) == text
    lines = text.splitlines()
    assert lines[0].startswith("memory: ") and "11.8 KiB on printed" in lines[0]
    assert lines[1].startswith("moved: ") and " from devices in " in lines[1]
    assert lines[2].split()[:3] == ["type", "rows", "host"] and "printed" in lines[2].split()
    shown = {line.split()[0]: line.split()[1:] for line in lines[3:]}
    assert shown["table_rows.pos"] == ["vector(float32,", "3)", "1,000", "(11.7", "KiB)", "11.8", "KiB"]
    assert shown["table_rows.mass"] == ["float64", "1,000", "7.8", "KiB"]


def test_what_is_gone_is_not_in_the_report(device) -> None:
    rows = ebb.Relation("gone_rows", size=10)
    rows.new_field("x", ebb.float32)
    rows.x.buffer.on(device)
    total = ebb.Global(ebb.int64, 0)
    many = sum(name.startswith("global ") for name in entries(ebb.memory()))
    assert "gone_rows.x" in entries(ebb.memory())
    del rows, total
    gc.collect()
    found = entries(ebb.memory())
    assert "gone_rows.x" not in found
    assert sum(name.startswith("global ") for name in found) == many - 1
