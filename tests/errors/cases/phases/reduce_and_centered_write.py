from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def push(v: vertices):
    v.force = [0, 0, 0]  #~ E301
    for e in v.edges:
        e.head.force += e.rest_len * v.q


push(vertices)
