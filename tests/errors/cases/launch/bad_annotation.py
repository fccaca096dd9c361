from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices, dt: float):  #~ E105
    v.mass = dt


step(vertices, 1.0)
