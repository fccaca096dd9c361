from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def push(e: edges):
    e.head.force += e.tail.force  #~ E301


push(edges)
