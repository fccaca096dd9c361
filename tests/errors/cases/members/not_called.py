from world import make_mesh

import ebb

vertices, edges = make_mesh()


@vertices.member
def toward(v, target):
    return target - v.q


@ebb.kernel
def step(v: vertices):
    v.qd = v.toward  #~ E125


step(vertices)
