from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    x = 1.0
    x = True  #~ E203
    v.mass = ebb.float32(x)


step(vertices)
