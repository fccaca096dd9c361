"""Ebb against C++, Numba, Taichi, Quadrants and Warp, in one run. ``python -m benchmarks.run --help``."""
