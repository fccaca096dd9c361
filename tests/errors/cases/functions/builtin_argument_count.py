from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = ebb.clamp(v.mass, 0.0)  #~ E220


step(vertices)
