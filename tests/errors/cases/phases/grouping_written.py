from world import make_mesh

import ebb

vertices, edges = make_mesh()
edges.new_field("next", edges, init=0)


@ebb.kernel
def turn(e: edges):
    for other in ebb.where(edges.tail, e.head):
        e.next = other
    e.tail = e.head  #~ E301


turn(edges)
