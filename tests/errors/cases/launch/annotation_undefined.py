from __future__ import annotations

from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices, dt: ebb.flaot32):  #~ E104
    v.q += dt * v.qd


step(vertices, 0.1)
