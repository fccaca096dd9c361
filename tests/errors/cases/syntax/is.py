from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if v.mass is None:  #~ E110
        v.mass = 1.0


step(vertices)
