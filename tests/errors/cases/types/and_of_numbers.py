from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if v.count and v.mass > 0:  #~ E211
        v.mass = 0


step(vertices)
