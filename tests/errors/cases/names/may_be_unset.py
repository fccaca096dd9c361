from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if v.mass > 1:
        heavy = v.mass
    v.mass = heavy  #~ E121


step(vertices)
