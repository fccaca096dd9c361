"""The backend ``cpu``: machine code on all cores of the processor."""

from __future__ import annotations

from ebb.backends.cpu.backend import CpuBackend, cpu_backend

__all__ = ["CpuBackend", "cpu_backend"]
