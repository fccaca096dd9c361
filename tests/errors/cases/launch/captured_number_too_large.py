from world import make_mesh

import ebb

vertices, edges = make_mesh()
n = 5


@ebb.kernel
def step(v: vertices):
    v.count = n  #~ E210


step(vertices)
n = 2**40
step(vertices)
