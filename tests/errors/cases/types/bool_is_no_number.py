from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if 5 < True:  #~ E201
        v.mass = 1.0


step(vertices)
