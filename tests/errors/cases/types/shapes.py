from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.q = v.q + [1.0, 2.0]  #~ E201


step(vertices)
