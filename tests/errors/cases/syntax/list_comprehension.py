from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.q = [x * 2 for x in v.q]  #~ E110


step(vertices)
