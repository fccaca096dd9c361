from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.count = 3_000_000_000  #~ E210


step(vertices)
