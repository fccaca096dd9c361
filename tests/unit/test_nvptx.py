"""PTX: which instructions operations become, and what of libdevice comes with them. ``ptxas`` takes all of it."""

from __future__ import annotations

import linecache
import re
from collections.abc import Sequence

import pytest

import ebb
from backends import HAS_WHEELS
from ebb.backends.compile import assembly_text, llvm_text
from ebb.backends.llvm import libdevice
from ebb.backends.llvm.nvptx import architecture
from ebb.backends.target import nvptx
from ebb.compiler import lir
from ebb.compiler.lower import Launched, facts_of, lower
from ebb.types.builtins import BUILTINS
from ptx import CAPABILITIES, assembled, ptxas

pytestmark = pytest.mark.skipif(ptxas() is None and not HAS_WHEELS, reason="there is no ptxas")

UNARY = (
    "sqrt", "cbrt", "exp", "log", "log2", "log10", "exp2", "expm1", "log1p", "asin", "acos", "atan", "sinh", "cosh",
    "tanh", "asinh", "acosh", "atanh", "floor", "ceil", "trunc", "round", "erf", "erfc", "gamma", "lgamma", "abs",
)  # fmt: skip
REDUCING = ("sin", "cos", "tan")
BINARY = ("atan2", "fmod", "copysign", "hypot")


def program_of(kernel, relation, group_size: int = 64, precision=lir.Precision.CONTRACT) -> lir.Program:
    checked = kernel._find_launch(relation, ()).specialisation.checked
    facts = facts_of(checked.kernel)
    return lower(
        checked.kernel, checked.phases, (), facts, Launched.ALL, precision, lir.Updates.ATOMIC, group_size=group_size
    )


def ptx_of(kernel, relation, capability: int = 80, **options) -> str:
    """The PTX of a kernel, which ``ptxas`` has taken."""
    text = assembly_text(program_of(kernel, relation, **options), nvptx(capability))
    assembled(text, capability)
    assert ".extern" not in text, "something was not linked"
    return text


def rows_of(type_, names: str = "x y z") -> ebb.Relation:
    rows = ebb.Relation("rows", size=2)
    for name in names.split():
        rows.new_field(name, type_, init=0)
    return rows


def kernel_of(statements: Sequence[str], rows: ebb.Relation):
    """A kernel whose body is ``statements``, over ``r``."""
    source = "@ebb.kernel\ndef apply(r: rows):\n" + "".join(f"    {statement}\n" for statement in statements)
    name = f"<{source}>"
    linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
    names = {"ebb": ebb, "rows": rows, **BUILTINS}
    exec(compile(source, name, "exec"), names)
    return names["apply"]


def applied(names: Sequence[str], type_):
    """A kernel that calls functions, and its relation."""
    rows = rows_of(type_)
    return kernel_of([f"r.z += {name}(r.x{', r.y' if name in BINARY else ''})" for name in names], rows), rows


# ---- Arithmetic ----


def quotients(type_):
    rows = rows_of(type_)

    @ebb.kernel
    def divide(r: rows):
        r.z = ebb.sqrt(r.x / r.y)

    return divide, rows


def test_quotients_and_roots_are_rounded_correctly() -> None:
    text = ptx_of(*quotients(ebb.float32))
    assert "div.rn.f32" in text
    assert "sqrt.rn.f32" in text
    assert "ftz" not in text, "subnormal numbers are kept"
    text = ptx_of(*quotients(ebb.float64))
    assert "div.rn.f64" in text
    assert "sqrt.rn.f64" in text


def test_quotients_and_roots_are_approximate_under_fastmath() -> None:
    text = ptx_of(*quotients(ebb.float32), precision=lir.Precision.FAST)
    assert re.search(r"(div|rcp|sqrt|rsqrt)\.approx", text)
    assert ".rn" not in text.replace("fma.rn", "")


def test_products_and_sums_are_fused() -> None:
    rows = rows_of(ebb.float32)

    @ebb.kernel
    def fuse(r: rows):
        r.z = r.x * r.y + r.z

    assert "fma.rn.f32" in ptx_of(fuse, rows)


def test_rows_of_sixteen_bytes_are_moved_whole() -> None:
    for type_, instruction in ((ebb.vec4f, "v4.b32"), (ebb.vec2d, "v2.b64"), (ebb.vec2f, "v2.b32")):
        rows = rows_of(type_)

        @ebb.kernel
        def add(r: rows):
            r.z = r.x + r.y

        assert re.findall(r"\b(?:ld|st)\.global\S*", ptx_of(add, rows)) == [
            f"ld.global.nc.{instruction}",
            f"ld.global.nc.{instruction}",
            f"st.global.{instruction}",
        ]


@pytest.mark.parametrize("capability", CAPABILITIES)
def test_minima_propagate_nan(capability: int) -> None:
    rows = rows_of(ebb.float32)

    @ebb.kernel
    def least(r: rows):
        r.z = min(r.x, r.y)

    text = ptx_of(least, rows, capability)
    assert "min.NaN.f32" in text if capability >= 80 else {"min.f32", "setp.nan.f32"} <= set(text.split())


@pytest.mark.parametrize("type_", [ebb.int32, ebb.uint32, ebb.int64, ebb.uint64])
def test_conversions_to_integers_make_nan_zero(type_) -> None:
    rows = ebb.Relation("rows", size=2)
    rows.new_field("x", ebb.float64)
    rows.new_field("n", type_)

    @ebb.kernel
    def convert(r: rows):
        r.n = type_(r.x)

    text = ptx_of(convert, rows)
    assert "cvt.rzi." in text
    # Comparisons that tell NaN from numbers; or a maximum, which is the other operand.
    assert re.search(r"setp\.(nan|num|ltu)\.f64|max\.f64\s+\S+ \S+ 0d0{16}", text)


# ---- Functions ----


@pytest.mark.parametrize("type_", [ebb.float32, ebb.float64], ids=str)
@pytest.mark.parametrize("capability", CAPABILITIES)
def test_every_function_is_linked(type_, capability: int) -> None:
    ptx_of(*applied((*UNARY, *REDUCING, *BINARY), type_), capability)


@pytest.mark.parametrize("capability", CAPABILITIES)
def test_functions_of_float32_stay_float32(capability: int) -> None:
    assert ".f64" not in ptx_of(*applied((*UNARY, *REDUCING, *BINARY), ebb.float32), capability)


def test_remainders_are_exact() -> None:
    for type_ in (ebb.float32, ebb.float64):
        rows = rows_of(type_)

        @ebb.kernel
        def divide(r: rows):
            r.x = r.y % r.z
            r.y = r.y // r.z

        assert "frem" not in llvm_text(program_of(divide, rows), nvptx(80)), "LLVM's is off for large quotients"
        ptx_of(divide, rows)


def test_powers() -> None:
    for type_ in (ebb.float32, ebb.float64, ebb.int32, ebb.uint64):
        rows = rows_of(type_)

        @ebb.kernel
        def raise_(r: rows):
            r.z = r.x**r.y

        text = ptx_of(raise_, rows)
        assert (".f64" in text) == (type_ == ebb.float64)


@pytest.mark.parametrize("type_", [ebb.float32, ebb.float64], ids=str)
def test_random_numbers(type_) -> None:
    rows = rows_of(type_)

    @ebb.kernel
    def draw(r: rows):
        r.x = ebb.rand(type_)
        r.y = ebb.randn(type_)

    ptx_of(draw, rows)


def test_without_libdevice_kernels_run_that_call_nothing_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(libdevice, "find_libdevice", lambda: None)
    ptx_of(*quotients(ebb.float32))
    with pytest.raises(ebb.BackendError, match="E618") as caught:
        ptx_of(*applied(("sin",), ebb.float64))
    text = " ".join(str(caught.value).split())
    assert "the code of sin for NVIDIA's GPUs is not installed" in text
    assert 'pip install "ebblang[cuda]"' in text
    assert "CUDA_HOME" in text


def test_libdevice_is_found_in_a_toolkit(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setattr(libdevice, "find_spec", lambda name: None)
    folder = tmp_path / "nvvm" / "libdevice"
    folder.mkdir(parents=True)
    (folder / "libdevice.10.bc").write_bytes(b"BC")
    monkeypatch.setenv("CUDA_HOME", str(tmp_path))
    find = libdevice.find_libdevice.__wrapped__
    assert find() == str(folder / "libdevice.10.bc")
    monkeypatch.setenv("CUDA_HOME", "/nowhere")
    monkeypatch.delenv("CUDA_PATH", raising=False)
    assert find() in (None, "/usr/local/cuda/nvvm/libdevice/libdevice.10.bc")


# ---- Reductions ----


def reducing(type_, op: str):
    """A kernel that reduces into rows that others reduce into."""
    targets = ebb.Relation("targets", size=2)
    targets.new_field("v", type_)
    rows = ebb.Relation("rows", size=3)
    rows.new_field("t", targets, init=0)
    rows.new_field("v", type_)
    statement = f"r.t.v = {op}(r.t.v, r.v)" if op in ("min", "max") else f"r.t.v {op}= r.v"
    return kernel_of([statement], rows), rows


@pytest.mark.parametrize(
    ("type_", "op", "instruction"),
    [
        (ebb.int32, "+", "add.u32"),
        (ebb.uint64, "+", "add.u64"),
        (ebb.float32, "+", "add.f32"),
        (ebb.float64, "+", "add.f64"),
        (ebb.int32, "min", "min.s32"),
        (ebb.int64, "max", "max.s64"),
        (ebb.uint32, "min", "min.u32"),
        (ebb.uint64, "max", "max.u64"),
        (ebb.int32, "&", "and.b32"),
        (ebb.int64, "^", "xor.b64"),
        (ebb.bool_, "|", "or.b32"),
        (ebb.bool_, "&", "and.b32"),
        (ebb.bool_, "^", "xor.b32"),
        (ebb.float32, "min", "cas.b32"),
        (ebb.float64, "max", "cas.b64"),
        (ebb.float32, "*", "cas.b32"),
        (ebb.float64, "*", "cas.b64"),
        (ebb.int32, "*", "cas.b32"),
    ],
    ids=lambda value: str(value),
)
@pytest.mark.parametrize("capability", CAPABILITIES)
def test_reductions_are_atomic(type_, op: str, instruction: str, capability: int) -> None:
    kernel, rows = reducing(type_, op)
    text = ptx_of(kernel, rows, capability)
    atomics = re.findall(r"\b(?:atom|red)\.\S+", text)
    assert len(atomics) == 1
    assert atomics[0].endswith(instruction)
    assert ".global" in atomics[0]
    if type_ != ebb.float64:
        assert ".f64" not in text


@pytest.mark.parametrize("group_size", [1, 32, 64, 100, 1024])
def test_groups_have_the_threads_that_they_are_launched_with(group_size: int) -> None:
    rows = rows_of(ebb.float32)
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def sum_up(r: rows):
        total.value += r.x

    text = ptx_of(sum_up, rows, group_size=group_size)
    assert set(re.findall(r"\.reqntid (\d+)", text)) == {str(group_size)}
    assert ("bar.sync" in text) == (group_size > 1)
    shared = {each.shared for each in assembled(text, 80).values()}
    assert max(shared) == (8 * group_size if group_size > 1 else 0)


# ---- Targets ----


@pytest.mark.parametrize(
    ("capability", "expected"),
    [(60, "sm_60"), (70, "sm_70"), (75, "sm_75"), (80, "sm_80"), (88, "sm_87"), (90, "sm_90"), (110, "sm_103"),
     (120, "sm_120"), (999, "sm_121")],
)  # fmt: skip
def test_newer_devices_get_what_older_ones_would(capability: int, expected: str) -> None:
    assert architecture(capability) == expected


@pytest.mark.parametrize("capability", CAPABILITIES)
def test_drivers_of_cuda_12_take_the_version(capability: int) -> None:
    text = ptx_of(*quotients(ebb.float32), capability)
    major, minor = map(int, re.search(r"\.version (\d+)\.(\d+)", text).groups())
    assert (major, minor) <= (8, 0)
    assert f".target sm_{capability}\n" in text
