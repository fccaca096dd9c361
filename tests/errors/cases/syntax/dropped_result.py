from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    ebb.normalize(v.qd)  #~ E112


step(vertices)
