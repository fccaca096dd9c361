from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    name = "q"  #~ E114
    v.mass = name


step(vertices)
