from world import make_mesh

import ebb

vertices, edges = make_mesh()
period = 0


@ebb.kernel
def step(v: vertices):
    v.mass *= 2 / period  #~ E126


step(vertices)
