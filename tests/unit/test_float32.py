"""A kernel in float32 makes no float64 instruction, on any target: GPUs have few of them, and some devices none."""

from __future__ import annotations

import math

import pytest

import ebb
import ptx
from ebb.backends.backend import CheckedKernel
from ebb.backends.cpu import cpu_backend
from ebb.backends.devices.stages import text_without_device
from example_runs import EXAMPLES


def doubles(checked: CheckedKernel) -> dict[str, list[str]]:
    """The lines that have to do with float64, by target."""
    texts = {stage: text_without_device(checked, stage) for stage in ("spirv", "ptx")}
    texts["llvm"] = cpu_backend().prepare(checked).inspect("llvm") or ""
    words = {"spirv": "OpTypeFloat 64", "ptx": "f64", "llvm": "double"}
    found = {
        stage: [line.strip() for line in text.splitlines() if words[stage] in line] for stage, text in texts.items()
    }
    return {stage: lines for stage, lines in found.items() if lines}


def in_float32(checked: CheckedKernel) -> bool:
    """Whether all that ``checked`` touches and takes is in float32 or no float at all."""
    kernel, phases = checked.kernel, checked.phases
    types = [place.type for place in (*phases.fields, *phases.globals)] + [uniform.type for uniform in kernel.uniforms]
    return all(type_.dtype.kind != "f" or type_.dtype.itemsize == 4 for type_ in types)


def prepared(monkeypatch: pytest.MonkeyPatch, run) -> list[CheckedKernel]:
    """The kernels that ``run`` launches."""
    with ptx.emitting(monkeypatch, keep=True) as made:
        run()
    return made.checked


@pytest.fixture
def rows() -> ebb.Relation:
    rows = ebb.Relation("rows", size=10)
    for name in "abc":
        rows.new_field(name, ebb.float32, init=0.5)
    rows.new_field("v", ebb.vec3f, init=1.0)
    rows.new_field("m", ebb.mat3f, init=1.0)
    rows.new_field("i", ebb.int32, init=3)
    rows.new_field("next", rows, init=0)
    return rows


ONE = (
    "abs sign sqrt cbrt exp exp2 expm1 log log2 log10 log1p sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
)
ONE += " fabs degrees radians erf erfc gamma lgamma floor ceil trunc round"
EXPRESSIONS = (
    *(f"{'ebb' if hasattr(ebb, name) else 'math'}.{name}(r.a)" for name in ONE.split()),
    *(
        f"{name}(r.a, r.b)"
        for name in ("ebb.pow", "ebb.atan2", "math.hypot", "math.fmod", "math.copysign", "min", "max")
    ),
    *(f"r.a {operator} r.b" for operator in ("+", "-", "*", "/", "//", "%", "**")),
    *("r.a * 0.1", "2 * r.a + dt", "r.a ** 2", "r.a ** 0.5", "ebb.float32(r.i) / 3", "ebb.float32(r.i // 2)"),
    *("ebb.rand(ebb.float32)", "ebb.randn(ebb.float32)", "ebb.length(r.v)", "ebb.normalize(r.v).x", "ebb.det(r.m)"),
    *("ebb.inverse(r.m)[0, 0]", "ebb.dot(r.m @ r.v, r.v)", "ebb.select(math.isnan(r.a), 0.5, r.a)"),
    *("ebb.clamp(r.a, 0.25, 0.75)", "ebb.float32(ebb.int64(r.a))"),
)


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_expressions(rows: ebb.Relation, expression: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (checked,) = prepared(monkeypatch, lambda: kernel_of(f"r.c = {expression}", rows, dt=1e-3)(rows))
    assert doubles(checked) == {}


@pytest.mark.parametrize("operator", ["+", "-", "*", "min", "max"])
def test_reductions(rows: ebb.Relation, operator: str, monkeypatch: pytest.MonkeyPatch) -> None:
    total = ebb.Global(ebb.float32, 1.0)
    if operator in ("min", "max"):
        body = f"total.value = {operator}(total.value, r.a)\nr.next.b = {operator}(r.next.b, r.a)"
    else:
        body = f"total.value {operator}= r.a\nr.next.b {operator}= r.a"
    (checked,) = prepared(monkeypatch, lambda: kernel_of(body, rows, total=total)(rows))
    assert doubles(checked) == {}


def kernel_of(body: str, rows: ebb.Relation, **names) -> ebb.Kernel:
    text = "def program(r: rows):\n" + "".join(f"    {line}\n" for line in body.splitlines())
    namespace = {"ebb": ebb, "math": math, "rows": rows, **names}
    exec(text, namespace)
    return ebb.kernel(source=text)(namespace["program"])


@pytest.mark.parametrize(("example", "least"), [("spring_mass", 4), ("rendermesh", 3)])
def test_kernels_of_the_examples(example: str, least: int, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = [checked for checked in prepared(monkeypatch, lambda: EXAMPLES[example]()[0](1)) if in_float32(checked)]
    assert len(kernels) >= least
    for checked in kernels:
        assert doubles(checked) == {}, checked.kernel.name
