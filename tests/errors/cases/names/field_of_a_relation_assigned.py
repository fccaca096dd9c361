from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    vertices.mass = 5  #~ E124


step(vertices)
