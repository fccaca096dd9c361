from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    x, *rest = v.q  #~ E110
    v.mass = x


step(vertices)
