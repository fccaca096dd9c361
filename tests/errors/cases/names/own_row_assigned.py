from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    for e in v.edges:
        v = e.head
    v.mass = 1.0  #~ E303


step(vertices)
