from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.count = ebb.coords(v)[0]  #~ E229


step(vertices)
