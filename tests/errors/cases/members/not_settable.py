from world import make_mesh

import ebb

vertices, edges = make_mesh()


@vertices.member
def speed(v):
    return ebb.length(v.qd)


@ebb.kernel
def step(v: vertices):
    v.speed = 0.0  #~ E230


step(vertices)
