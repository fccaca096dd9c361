from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.func
def reset(v):
    v.mass = 1.0


@ebb.kernel
def step(v: vertices):
    v.mass = reset(v)  #~ E222


step(vertices)
