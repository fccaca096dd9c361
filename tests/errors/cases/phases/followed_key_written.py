from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def turn(v: vertices):
    for e in v.edges:
        e.tail = e.head  #~ E303


turn(vertices)
