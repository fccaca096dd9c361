from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    around = v.edges  #~ E130
    if v.fixed:
        around = ebb.where(edges.tail, v)
    for e in around:
        v.mass += e.rest_len


step(vertices)
