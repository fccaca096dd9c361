from world import make_mesh

import ebb

vertices, edges = make_mesh()


@vertices.member
def weight(v):
    return 9.81 * v.mass


@ebb.kernel
def step(v: vertices):
    v.weight *= 1.0  #~ E230


step(vertices)
