from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    table = {0: 1.0}  #~ E110
    v.mass = table[0]


step(vertices)
