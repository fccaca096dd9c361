from world import make_mesh

import ebb

vertices, edges = make_mesh()


@vertices.member
def momentum(v):
    return v.qd * v.mass


@ebb.kernel
def step(v: vertices):
    v.momentum.x = 1.0  #~ E124


step(vertices)
