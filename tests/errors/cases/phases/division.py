from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def push(e: edges):
    e.head.mass /= 2.0  #~ E303


push(edges)
