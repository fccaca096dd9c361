from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def turn_round(e: edges):
    e.tail = e.head


@ebb.kernel
def count(v: vertices):
    for e in v.edges:
        v.count += 1


with ebb.capture() as step:
    turn_round(edges)
    count(vertices)  #~ E609
