from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    name = "q"  #~
    v.mass = name


step(vertices)
