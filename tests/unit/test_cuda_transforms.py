"""cuFFT in the memory of fields: what it is called with, by a stand-in for it and for the driver, and on a GPU."""

from __future__ import annotations

import ctypes
import gc
import sys
import types
from collections.abc import Iterator
from enum import IntEnum
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_cuda_driver import FakeDriver

import ebb
from ebb.runtime.device import current_device

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import device_transforms
from device_transforms import CudaTransforms, transforms_on
from fluids_fft import Fluid, transforms_for


class FakeCufft:
    """The functions of ``nvmath.bindings.cufft`` that are called, on memory of the host, as the fake driver's is."""

    class Type(IntEnum):
        R2C = 0x2A
        C2R = 0x2C

    def __init__(self, driver: FakeDriver, device: list[int]) -> None:
        self.driver, self.device = driver, device
        self.plans: dict[int, tuple[int, int, int]] = {}
        self.streams: dict[int, int] = {}
        self.made = 0

    def get_version(self) -> int:
        return 11300

    def create(self) -> int:
        self.made += 1
        return self.made

    def make_plan2d(self, plan: int, nx: int, ny: int, kind: int) -> int:
        assert self.device, "no device has been chosen"
        self.plans[plan] = nx, ny, kind
        return 0

    def set_stream(self, plan: int, stream: int) -> None:
        self.streams[plan] = stream

    def destroy(self, plan: int) -> None:
        del self.plans[plan]

    def exec_r2c(self, plan: int, source: int, target: int) -> None:
        nx, ny, kind = self.plans[plan]
        assert kind == self.Type.R2C and self.streams[plan] == FakeDriver.CU_STREAM_LEGACY
        values, waves = self._array(source, (nx, ny), "f4"), self._array(target, (nx, ny // 2 + 1), "c8")
        waves[...] = np.fft.rfft2(values)

    def exec_c2r(self, plan: int, source: int, target: int) -> None:
        nx, ny, kind = self.plans[plan]
        assert kind == self.Type.C2R and self.streams[plan] == FakeDriver.CU_STREAM_LEGACY
        values, waves = self._array(target, (nx, ny), "f4"), self._array(source, (nx, ny // 2 + 1), "c8")
        values[...] = np.fft.irfft2(waves, (nx, ny)) * nx * ny
        waves[...] = np.nan  # as cuFFT does in more than one dimension

    def _array(self, address: int, shape: tuple[int, int], kind: str) -> np.ndarray:
        size = prod(shape) * np.dtype(kind).itemsize
        assert len(self.driver.memory[address]) >= size, "no memory of the device"
        return np.frombuffer((ctypes.c_ubyte * size).from_address(address), kind).reshape(shape)


@pytest.fixture
def cufft(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeCufft]:
    driver, device = FakeDriver(), list[int]()
    library = FakeCufft(driver, device)
    runtime = types.SimpleNamespace(
        cudaSetDevice=lambda number: (device.append(number) or 0,), cudaStreamLegacy=driver.CU_STREAM_LEGACY
    )
    for name, module in {
        "cuda.bindings.driver": driver,
        "cuda.bindings": types.SimpleNamespace(driver=driver, runtime=runtime),
        "nvmath": types.SimpleNamespace(__spec__=object()),
        "nvmath.bindings": types.SimpleNamespace(cufft=library),
    }.items():
        monkeypatch.setitem(sys.modules, name, module)
    with ebb.backend("cuda"):
        yield library


def make_fluid(n: int, transforms: Any) -> Fluid:
    fluid = Fluid(n, transforms=transforms)
    fluid.grid.cells.u.load(np.random.default_rng(n).normal(size=(n, n)).astype(np.float32))
    return fluid


@pytest.mark.parametrize("n", [7, 8])
def test_it_reads_and_writes_the_memory_of_fields(cufft: FakeCufft, n: int) -> None:
    transforms = transforms_on("cuda")
    assert isinstance(transforms, CudaTransforms) and transforms_for("cuda", 1).package == "cuFFT"
    fluid = make_fluid(n, transforms)
    cells, waves = fluid.grid.cells, fluid.frequencies
    given = cells.u.to_numpy()
    for _ in range(2):
        transforms.forward(cells.u, waves.u)
    pairs = waves.u.to_numpy()
    np.testing.assert_allclose(pairs[..., 0] + 1j * pairs[..., 1], np.fft.rfft2(given), atol=1e-4)
    device = current_device()
    assert transforms.memory == {field.path: field.buffer.on(device).address for field in (cells.u, waves.u)}
    transforms.inverse(waves.u, cells.v)
    launched = cufft.driver.launches
    assert len(launched) == 1 and "scale" in launched[0][0], "which the stand-in does not run"
    assert np.float32(1 / n**2).tobytes() in launched[0][3]
    np.testing.assert_allclose(cells.v.to_numpy() / n**2, given, atol=1e-6)
    assert cufft.made == 2 and set(cufft.device) == {0}
    del fluid, transforms
    gc.collect()
    assert not cufft.plans


def test_nothing_moves_between_transforms(cufft: FakeCufft) -> None:
    transforms = CudaTransforms()
    fluid = make_fluid(8, transforms)
    cells, waves = fluid.grid.cells, fluid.frequencies
    transforms.forward(cells.u, waves.u)
    transforms.inverse(waves.u, cells.u)
    before = len(cufft.driver.calls)
    for _ in range(3):
        transforms.forward(cells.u, waves.u)
        transforms.inverse(waves.u, cells.u)
    assert not [name for name, _ in cufft.driver.calls[before:] if "HtoD" in name or "DtoH" in name]


def test_without_the_library_the_host_transforms(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> int:
        raise RuntimeError("libcufft.so is not there")

    monkeypatch.setattr(device_transforms, "find_spec", lambda name: None)
    assert transforms_on("cuda") is None and transforms_on("opencl") is None
    monkeypatch.setattr(device_transforms, "find_spec", lambda name: object())
    library = types.SimpleNamespace(get_version=refuse)
    monkeypatch.setitem(sys.modules, "nvmath", types.SimpleNamespace())
    monkeypatch.setitem(sys.modules, "nvmath.bindings", types.SimpleNamespace(cufft=library))
    assert transforms_on("cuda") is None and transforms_on("cpu") is None


@pytest.mark.parametrize("n", [9, 16])
def test_a_gpu_transforms_as_the_host_does(n: int) -> None:
    pytest.importorskip("nvmath.bindings.cufft")
    try:
        ebb.set_backend("cuda")
    except ebb.BackendError as error:
        pytest.skip(str(error))
    try:
        transforms = CudaTransforms()
    finally:
        ebb.set_backend("cpu")
    found = []
    for backend, by in (("cpu", None), ("cuda", transforms)):
        with ebb.backend(backend):
            fluid = make_fluid(n, by)
            for _ in range(2):
                fluid.step()
            found.append(fluid.velocity())
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)
