from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    x, y = v.q  #~ E225
    v.mass = x + y


step(vertices)
