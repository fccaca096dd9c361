from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    while v.count:  #~ E211
        v.count -= 1


step(vertices)
