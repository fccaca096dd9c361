from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = ebb.length(ebb.vec2f(v.q))  #~ E208


step(vertices)
