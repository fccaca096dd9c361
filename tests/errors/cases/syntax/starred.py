from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    x, *rest = v.q  #~ E110 E225
    v.mass = x


step(vertices)
