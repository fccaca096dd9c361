from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices, dt: ebb.float32):
    v.q += dt * v.qd


step(vertices, "fast")  #~ E263
