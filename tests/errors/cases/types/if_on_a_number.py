from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if v.count:  #~ E211
        v.mass = 0


step(vertices)
