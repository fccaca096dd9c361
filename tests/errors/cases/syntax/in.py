from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if v.count in (1, 2, 3):  #~ E110
        v.mass = 1.0


step(vertices)
