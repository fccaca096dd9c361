from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    x = 1.0
    x = True  #~
    v.mass = x


step(vertices)
