"""The backend that devices share: what it binds, launches and moves, how it fails, and that sums may be repeatable."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass

import numpy as np
import pytest

import ebb
from backends import lacking
from ebb.backends import select
from ebb.backends.backend import Once
from ebb.backends.cache import ObjectCache
from ebb.backends.devices.backend import DeviceBackend
from ebb.backends.llvm.group import parameters
from ebb.backends.target import spirv
from ebb.runtime import device as protocol
from ebb.runtime import random
from fake_device import FakeDevice

opencl = pytest.mark.skipif(lacking("opencl") is not None, reason=str(lacking("opencl")))


@dataclass
class Launched:
    """A launch that the device was given."""

    name: str
    groups: int
    group_size: int
    arguments: tuple


class RecordingDevice(FakeDevice):
    """Notes launches, and runs what a test says in the place of the kernels."""

    def __init__(self):
        super().__init__(name="recorder")
        self.launches = []
        self.instead = lambda launched: None
        self.room = None

    def allocate(self, nbytes):
        if self.room is not None:
            self.room -= 1
            if self.room < 0:
                raise ebb.BackendError()
        return super().allocate(nbytes)

    def load(self, kernel, image, entries):
        assert image[:4] == b"\x03\x02#\x07"  # SPIR-V
        return entries

    def launch(self, entry, groups, group_size, arguments):
        launched = Launched(entry, groups, group_size, tuple(arguments))
        self.launches.append(launched)
        super().launch(lambda *_: self.instead(launched), groups, group_size, arguments)


@pytest.fixture
def device():
    """A recording device, which is what all kernels run on meanwhile."""
    found = RecordingDevice()
    with running_on(DeviceBackend("recorder", found, spirv(), ObjectCache(), False, True)):
        yield found


@contextmanager
def running_on(backend):
    before = select._selection.backend
    select._select(backend)
    try:
        yield
    finally:
        select._select(before)


def rows_of(size, **fields):
    rows = ebb.Relation("rows", size=size)
    for name, type_ in fields.items():
        rows.new_field(name, type_)
    return rows


# ---- What is launched ----


def test_a_launch_has_its_rows_its_fields_and_its_uniforms(device):
    rows = rows_of(130, x=ebb.float32)

    @ebb.kernel
    def scale(r: rows, a: ebb.float32, n: ebb.int64, on: ebb.bool_):
        if on:
            r.x = a * r.x + n

    scale(rows, 1e300, 2**40, True)
    (launched,) = device.launches
    assert launched.name == "ebb_scale" and launched.groups == 3 and launched.group_size == 64
    scalars = [each for each in launched.arguments if isinstance(each, np.generic)]
    assert [(type(each), int(each)) for each in scalars[:4]] == [(np.int64, each) for each in (0, 0, 0, 130)]
    found = {type(each): each for each in scalars[4:]}
    assert found == {np.float32: np.float32(np.inf), np.int64: 2**40, np.uint8: 1}


def test_each_box_is_a_launch_and_knows_what_was_before(device):
    cells = ebb.Relation("cells", shape=(10, 20))
    cells.new_field("x", ebb.float32)
    ring = cells.new_subset("ring", [np.s_[0:1, :], np.s_[9:10, :], np.s_[1:9, 3:7]])

    @ebb.kernel(block_size=8)
    def clear(c: cells):
        c.x = 1

    clear(ring)
    words = [[int(word) for word in each.arguments[1:7]] for each in device.launches]
    assert [each.groups for each in device.launches] == [3, 3, 4]
    assert words == [[0, 0, 0, 1, 0, 20], [3, 20, 9, 10, 0, 20], [6, 40, 1, 9, 3, 7]]


def test_sums_into_globals_take_a_second_launch(device):
    rows = rows_of(200_000, x=ebb.float64)
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel(block_size=32)
    def add(r: rows):
        total.value += r.x

    add(rows)
    first, second = device.launches
    assert (first.name, first.groups) == ("ebb_add", 1024)
    assert (second.name, second.groups, second.group_size) == ("ebb_add_finish", 1, 32)
    assert max(each.nbytes for each in first.arguments if not isinstance(each, np.generic)) >= 200_000 * 8


def test_parameters_are_as_many_as_arguments(device):
    rows = rows_of(3, x=ebb.vec3f)

    @ebb.kernel
    def turn(r: rows, m: ebb.mat3f):
        r.x = m @ r.x

    turn(rows, np.eye(3))
    (program,) = bound_programs(turn, rows)
    assert len(parameters(program)) == len(device.launches[0].arguments)


def bound_programs(kernel, rows):
    """The programs of the last launch."""
    (launch,) = kernel._known_launches(rows)
    bound = launch.bound.bound if isinstance(launch.bound, Once) else launch.bound
    return [binding._program for binding in getattr(bound, "bindings", (bound,))]


def test_nothing_runs_on_no_rows_but_a_launch_that_draws_counts(device):
    rows = rows_of(0, x=ebb.float64)

    @ebb.kernel
    def draw(r: rows):
        r.x = ebb.rand(ebb.float64)

    before = random.present_key().launch
    draw(rows)
    assert device.launches == [] and random.present_key().launch == before + 1


def test_code_is_compiled_once(device):
    rows = rows_of(5, x=ebb.float64)
    loaded = []
    device.load = lambda kernel, image, entries: loaded.append(kernel) or entries

    @ebb.kernel
    def grow(r: rows):
        r.x += 1

    grow(rows)
    grow(rows)
    with ebb.backend("cpu"):
        grow(rows)
    grow(rows)
    assert loaded == ["grow"]


def test_what_the_device_lacks_is_said_before_anything_runs(device):
    rows = rows_of(5, x=ebb.float64, n=ebb.int64, f=ebb.float32)

    @ebb.kernel
    def wide(r: rows):
        r.x += 1

    @ebb.kernel
    def narrow(r: rows):
        r.f += 1

    device.lacks = frozenset({protocol.Feature.FLOAT64})
    with pytest.raises(ebb.BackendError, match=r"lacks ebb\.float64, which kernel 'wide'") as caught:
        wide(rows)
    assert caught.value.codes == ("E613",) and "ebb.float32" in str(caught.value)
    assert device.launches == []
    narrow(rows)
    assert len(device.launches) == 1


# ---- What is moved ----


def test_a_field_that_is_overwritten_is_not_uploaded(device):
    rows = rows_of(100, x=ebb.float64, y=ebb.float64)

    @ebb.kernel
    def copy(r: rows):
        r.y = r.x

    for _ in range(3):
        copy(rows)
    assert [move for move in device.taken_moves() if move[1] == 800] == [("up", 800)]
    rows.x.to_numpy()
    assert device.taken_moves() == []
    rows.y.to_numpy()
    assert device.taken_moves() == [("down", 800)]


def test_a_launch_that_finds_no_room_has_not_run(device):
    rows = rows_of(100, x=ebb.float64, y=ebb.float64, z=ebb.float64)
    rows.x.fill(1.0)

    @ebb.kernel
    def add(r: rows):
        r.z += r.x + r.y
        r.x += 1

    device.room = 2
    with pytest.raises(ebb.BackendError):
        add(rows)
    assert device.launches == []
    np.testing.assert_array_equal(rows.x.to_numpy(), np.ones(100))
    device.room = None
    add(rows)
    assert len(device.launches) == 1


def test_a_launch_that_is_refused_leaves_the_values(device):
    rows = rows_of(100, x=ebb.float64, y=ebb.float64)
    rows.x.fill(1.0)
    rows.y.fill(2.0)

    @ebb.kernel
    def copy(r: rows):
        r.y = r.x
        r.x += 1

    launch, device.launch = device.launch, refuse
    with pytest.raises(ebb.BackendError):
        copy(rows)
    device.launch = launch
    np.testing.assert_array_equal(rows.x.to_numpy(), np.full(100, 1.0))
    np.testing.assert_array_equal(rows.y.to_numpy(), np.full(100, 2.0))


def refuse(*_):
    raise ebb.BackendError()


# ---- Failures and prints ----


def failing_at(*rows):
    """Leaves records of failures of the first site: row ``n`` of the launch, at the position ``2 n``."""

    def leave(launched):
        words = launched.arguments[0].bytes
        words[:16].view(np.uint32)[[protocol.FAILURE_LOWEST, protocol.FAILURE_COUNT]] = min(rows) // 64, len(rows)
        records = words[16:].view(np.int64).reshape(-1, protocol.FAILURE_WORDS)
        for record, row in zip(records, rows, strict=False):
            record[:3] = row, 2 * row, 1

    return leave


def checking(rows):
    @ebb.kernel
    def check(r: rows):
        assert r.x < 1

    return check


def test_the_failure_of_the_first_row_is_raised_and_forgotten(device):
    rows = rows_of(1000, x=ebb.float64)
    check = checking(rows)
    device.instead = failing_at(90, 70, 75)
    with pytest.raises(ebb.KernelAssertionError, match=r"row (rows\[)?140"):
        check(rows)
    device.instead = lambda launched: None
    check(rows)


def test_a_launch_that_was_interrupted_leaves_no_failure(device):
    rows = rows_of(1000, x=ebb.float64)
    check = checking(rows)
    device.instead = failing_at(3)
    download = device.download

    def interrupted(source, target):
        device.wait()
        raise KeyboardInterrupt

    device.download = interrupted
    with pytest.raises(KeyboardInterrupt):
        check(rows)
    device.download = download
    device.instead = lambda launched: None
    check(rows)


def test_sums_into_globals_are_left_where_a_row_fails(device):
    rows = rows_of(10, x=ebb.float64)
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def add(r: rows):
        assert r.x < 1
        total.value += r.x

    device.instead = failing_at(3)
    with pytest.raises(ebb.KernelAssertionError):
        add(rows)
    assert [each.name for each in device.launches] == ["ebb_add"]


# ---- On a real device ----


@pytest.fixture
def on_opencl():
    with ebb.backend("opencl"):
        yield


def spring_mesh(vertex_count=2_000, edge_count=9_000, seed=3):
    generator = np.random.default_rng(seed)
    vertices, edges = ebb.Relation("vertices", size=vertex_count), ebb.Relation("edges", size=edge_count)
    ends = generator.integers(0, vertex_count, (edge_count, 2))
    edges.new_field("tail", vertices, init=ends[:, 0])
    edges.new_field("head", vertices, init=ends[:, 1])
    edges.new_field("weight", ebb.float32, init=generator.normal(size=edge_count).astype(np.float32))
    vertices.new_field("sum", ebb.float32)
    vertices.new_field("picked", vertices, init=generator.integers(0, vertex_count, vertex_count))
    return vertices, edges, ends


@opencl
def test_sums_repeat_their_bits_where_asked():
    vertices, edges, ends = spring_mesh()

    @ebb.kernel
    def scatter(e: edges):
        e.tail.sum += e.weight
        e.head.sum += e.weight

    expected = np.zeros(vertices.size)
    for column in ends.T:
        expected += np.bincount(column, edges.weight.to_numpy().astype(np.float64), vertices.size)
    with ebb.backend("opencl", deterministic=True):
        found = set()
        for _ in range(5):
            vertices.sum.fill(0)
            scatter(edges)
            found.add(vertices.sum.to_numpy().tobytes())
        np.testing.assert_allclose(vertices.sum.to_numpy(), expected, atol=1e-4)
        assert len(found) == 1
        with redirect_stdout(io.StringIO()):
            text = scatter.explain(edges)
        assert "gathered" in text or "staged" in text
    with ebb.backend("opencl"):
        vertices.sum.fill(0)
        scatter(edges)
        np.testing.assert_allclose(vertices.sum.to_numpy(), expected, atol=1e-4)
        with redirect_stdout(io.StringIO()):
            assert "atomically" in scatter.explain(edges)


@opencl
def test_sums_at_computed_places_run_in_order_where_bits_shall_repeat():
    vertices, edges, _ = spring_mesh(50, 3_000)

    @ebb.kernel
    def scatter(e: edges):
        end = e.tail
        for _ in range(3):
            end = end.picked
        end.sum += e.weight

    results = {}
    for name, options in (("reference", {}), ("opencl", {"deterministic": True})):
        vertices.sum.fill(0)
        with ebb.backend(name, **options):
            scatter(edges)
            results[name] = vertices.sum.to_numpy().tobytes()
            with redirect_stdout(io.StringIO()):
                text = scatter.explain(edges)
    assert results["reference"] == results["opencl"]
    assert "the places depend on" in text and "row after row" in text


@opencl
@pytest.mark.parametrize("size", [1, 2, 7, 32, 64, 100, 256, 1000, 1024])
def test_integers_do_not_depend_on_the_block_size(on_opencl, size):
    vertices, edges, ends = spring_mesh(100, 3_000)
    vertices.new_field("count", ebb.int32)
    total, least = ebb.Global(ebb.int64, 0), ebb.Global(ebb.int32, 1_000_000)

    @ebb.kernel
    def count(e: edges):
        e.tail.count += 1
        total.value += ebb.id(e)
        least.value = min(least.value, ebb.int32(ebb.id(e)) - 5)

    count(edges, block_size=size)
    np.testing.assert_array_equal(vertices.count.to_numpy(), np.bincount(ends[:, 0], minlength=100))
    assert total.value == 3_000 * 2_999 // 2 and least.value == -5
    with ebb.capture() as step:
        count(edges, block_size=size)
    step.run(3)
    assert total.value == 4 * (3_000 * 2_999 // 2)


@pytest.mark.parametrize("size", [0, -1, 1025, 2.5, "64", True, None])
def test_no_block_size(size):
    rows = rows_of(3, x=ebb.float64)

    @ebb.kernel
    def grow(r: rows):
        r.x += 1

    for call in (grow, grow.check, grow.explain):
        with pytest.raises(ebb.KernelTypeError) as caught:
            call(rows, block_size=size)
        assert caught.value.codes == ("E266",)
    with pytest.raises(ebb.KernelTypeError):
        ebb.kernel(block_size=size)(lambda r: None)
    np.testing.assert_array_equal(rows.x.to_numpy(), np.zeros(3))


def test_a_parameter_may_be_called_block_size():
    rows = rows_of(3, x=ebb.float64)

    @ebb.kernel
    def grow(r: rows, block_size: ebb.float64):
        r.x += block_size

    grow(rows, block_size=2000.0)
    np.testing.assert_array_equal(rows.x.to_numpy(), np.full(3, 2000.0))


def test_a_block_size_is_no_matter_on_the_processor():
    rows = rows_of(3, x=ebb.float64)

    @ebb.kernel
    def grow(r: rows, by: ebb.float64 = 1.0):
        r.x += by

    for backend in ("cpu", "reference"):
        with ebb.backend(backend):
            grow(rows, block_size=128)
            grow(rows, 2.0, block_size=128)
            grow(rows, by=3.0, block_size=64)
    np.testing.assert_array_equal(rows.x.to_numpy(), np.full(3, 12.0))


@pytest.mark.parametrize("backend", ["cpu", "reference", pytest.param("opencl", marks=opencl)])
def test_ptx_and_spirv_are_shown_on_every_backend(backend):
    rows = rows_of(3, x=ebb.float32)

    @ebb.kernel
    def grow(r: rows):
        r.x += 1

    with ebb.backend(backend):
        ptx, code = grow.inspect(rows, "ptx", block_size=96), grow.inspect(rows, "spirv")
        with pytest.raises(ebb.KernelTypeError, match=r"ptx, spirv|spirv, ptx"):
            grow.inspect(rows, "nothing of the kind")
    assert ".entry ebb_grow" in ptx and "96" in ptx
    assert "OpEntryPoint Kernel" in code and '"ebb_grow"' in code


@opencl
def test_prints_come_in_the_order_of_rows(on_opencl):
    rows = rows_of(300, x=ebb.float64)

    @ebb.kernel
    def tell(r: rows, bad: ebb.int64):
        print(ebb.id(r))
        assert ebb.id(r) != bad

    for bad, count in ((-1, 300), (100, 101)):
        with redirect_stdout(io.StringIO()) as printed:
            try:
                tell(rows, bad)
            except ebb.KernelAssertionError:
                assert bad == 100
        assert printed.getvalue().split() == [str(i) for i in range(count)]


@opencl
def test_two_threads_launch(on_opencl):
    rows = rows_of(5_000, x=ebb.int64, y=ebb.int64)

    @ebb.kernel
    def grow(r: rows, by: ebb.int64):
        r.x += by

    @ebb.kernel
    def grow_other(r: rows):
        r.y += 1

    failures = []

    def work(run):
        try:
            for _ in range(200):
                run()
        except BaseException as error:
            failures.append(error)

    runs = (lambda: grow(rows, 1), lambda: grow(rows, 2), lambda: grow_other(rows), lambda: rows.y.to_numpy())
    threads = [threading.Thread(target=work, args=(run,)) for run in runs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    np.testing.assert_array_equal(rows.x.to_numpy(), np.full(5_000, 600))
    np.testing.assert_array_equal(rows.y.to_numpy(), np.full(5_000, 200))


AT_THE_END = """
import threading
import ebb

rows = ebb.Relation("rows", size=1000)
rows.new_field("x", ebb.float32)

@ebb.kernel
def grow(r: rows):
    assert r.x >= 0
    r.x += 1

def work():
    while True:
        grow(rows)
        rows.x.to_numpy()

ebb.set_backend("opencl")
grow(rows)
threading.Thread(target=work, daemon=True).start()
"""


@opencl
def test_a_process_ends_whose_threads_launch(tmp_path):
    program = tmp_path / "at_the_end.py"
    program.write_text(AT_THE_END)
    for _ in range(3):
        ended = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, timeout=60)
        assert (ended.returncode, ended.stderr) == (0, "")


@opencl
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="there are no timers")
def test_an_interrupt_leaves_true_values(on_opencl):
    rows = rows_of(20_000, x=ebb.int64, y=ebb.int64)

    @ebb.kernel
    def step(r: rows):
        r.y = r.x
        r.x += 1

    armed = False

    def interrupt(*_):
        if armed:
            raise KeyboardInterrupt

    step(rows)
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        for delay in np.linspace(1e-5, 3e-3, 60):
            rows.x.fill(7)
            rows.y.fill(5)
            try:
                armed = True
                signal.setitimer(signal.ITIMER_REAL, delay)
                for _ in range(20):
                    step(rows)
                armed = False
            except KeyboardInterrupt:
                armed = False
            x, y = rows.x.to_numpy(), rows.y.to_numpy()
            assert len(set(x.tolist())) == len(set(y.tolist())) == 1
            assert 7 <= x[0] <= 27 and (y[0] == 5 or 7 <= y[0] <= x[0])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def explained(kernel, rows):
    with redirect_stdout(io.StringIO()):
        return kernel.explain(rows)


@opencl
def test_keys_that_change_before_each_launch_are_summed_in_order():
    vertices, edges, _ = spring_mesh(200, 1_000)

    @ebb.kernel
    def scatter(e: edges):
        e.tail.sum += e.weight

    ways = []
    with ebb.backend("opencl", deterministic=True):
        for shift in range(4):
            ends = (np.arange(1_000) * 7 + shift) % 200
            edges.tail.load(ends)
            vertices.sum.fill(0)
            scatter(edges)
            expected = np.bincount(ends, edges.weight.to_numpy(), 200)
            np.testing.assert_allclose(vertices.sum.to_numpy(), expected, atol=1e-4)
            ways.append(bound_programs(scatter, edges)[0].in_order)
    assert ways == [False, False, True, True]


@opencl
def test_a_kernel_that_prints_and_sums_runs_in_order():
    vertices, edges, ends = spring_mesh(10, 40)

    @ebb.kernel
    def scatter(e: edges):
        e.tail.sum += e.weight
        print(ebb.id(e))

    with ebb.backend("opencl", deterministic=True), redirect_stdout(io.StringIO()) as printed:
        scatter(edges)
    assert printed.getvalue().split() == [str(i) for i in range(40)]
    with ebb.backend("opencl", deterministic=True):
        assert "since the kernel prints" in explained(scatter, edges)
    np.testing.assert_allclose(vertices.sum.to_numpy(), np.bincount(ends[:, 0], edges.weight.to_numpy(), 10), atol=1e-5)


@opencl
def test_sums_are_gathered_in_ranges_where_rows_are_grouped():
    vertices, edges, ends = spring_mesh()
    edges.group_by("tail")

    @ebb.kernel
    def scatter(e: edges):
        e.tail.sum += e.weight

    with ebb.backend("opencl", deterministic=True):
        scatter(edges)
        assert "its groups are ranges" in explained(scatter, edges)
    expected = np.bincount(ends[:, 0], edges.weight.to_numpy(), vertices.size)
    np.testing.assert_allclose(vertices.sum.to_numpy(), expected, atol=1e-4)


@opencl
def test_values_that_cannot_be_computed_again_are_staged():
    vertices, edges, _ = spring_mesh()
    edges.new_field("drawn", ebb.float32)

    @ebb.kernel
    def scatter(e: edges):
        e.drawn = ebb.rand(ebb.float32)
        e.tail.sum += e.drawn
        e.head.sum += 2 * e.drawn

    found = set()
    with ebb.backend("opencl", deterministic=True):
        for _ in range(3):
            ebb.seed(7)
            vertices.sum.fill(0)
            scatter(edges)
            found.add((vertices.sum.to_numpy().tobytes(), edges.drawn.to_numpy().tobytes()))
        assert "staged" in explained(scatter, edges)
    assert len(found) == 1
    expected = sum(
        factor * np.bincount(edges.fields[name].to_numpy(), edges.drawn.to_numpy(), vertices.size)
        for name, factor in (("tail", 1), ("head", 2))
    )
    np.testing.assert_allclose(vertices.sum.to_numpy(), expected, rtol=1e-4)


@opencl
def test_explain_says_how_a_device_sums(on_opencl):
    _, edges, _ = spring_mesh(10, 40)
    total = ebb.Global(ebb.float32, 0.0)

    @ebb.kernel(block_size=96)
    def scatter(e: edges):
        e.tail.sum += e.weight
        total.value += e.weight

    text = explained(scatter, edges)
    assert "into other rows, atomically, in any order" in text
    assert "one partial result a work-group" in text
    assert "96 threads are a work-group" in text


@opencl
def test_a_step_is_replayed_on_the_device(on_opencl):
    rows = rows_of(500, x=ebb.int64, y=ebb.int64)
    count, limit = ebb.Global(ebb.int64, 0), ebb.Global(ebb.int64, 0)

    @ebb.kernel
    def step(r: rows):
        r.x = r.y + 1 + limit.value
        count.value += 1

    with ebb.capture() as recorded:
        limit.value = 2
        step(rows)
        rows.swap("x", "y")
        limit.value = 0
        step(rows)
    before = count.value
    assert before == 0
    recorded.run(20)
    expected_x, expected_y = 0, 0
    for _ in range(20):
        expected_x = expected_y + 3
        expected_x, expected_y = expected_y, expected_x
        expected_x = expected_y + 1
    assert (rows.x.to_numpy() == expected_x).all() and (rows.y.to_numpy() == expected_y).all()
    assert count.value == 20 * 2 * 500 and limit.value == 0


@opencl
def test_options_of_a_device_are_looked_at_before_it_is_chosen():
    for options, code in (({"deterministic": "yes"}, "E606"), ({"reorder": 1}, "E606"), ({"threads": 2}, "E602")):
        with pytest.raises(ebb.BackendError) as caught:
            ebb.set_backend("opencl", **options)
        assert caught.value.codes == (code,)


@opencl
def test_a_choice_of_options_is_one_backend():
    chosen = []
    for options in ({}, {"device": None}, {"deterministic": True}, {}):
        with ebb.backend("opencl", **options):
            chosen.append(select.current_backend())
    assert chosen[0] is chosen[1] is chosen[3] is not chosen[2]
    assert chosen[0].device is chosen[2].device
