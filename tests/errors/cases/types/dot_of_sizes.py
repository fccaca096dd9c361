from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = ebb.dot(v.q, [1.0, 2.0])  #~ E220


step(vertices)
