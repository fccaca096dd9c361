"""The numbers in the programs."""

from __future__ import annotations

DT = 1e-4
STIFFNESS = 1.0
AXPY_FACTOR = 1e-3
STENCIL_CENTER = 0.4
STENCIL_SIDE = 0.1
PCG_ITERATIONS = 20
PARTICLE_DT = 2e-3
PARTICLE_CELLS = 256
FMA_PER_STEP = 1 << 24
