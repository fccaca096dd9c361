from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.q = [1, 2, True]  #~ E204


step(vertices)
