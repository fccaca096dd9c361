from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    import math  #~ E110

    v.mass = math.pi


step(vertices)
