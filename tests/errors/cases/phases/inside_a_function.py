from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.func
def pull(v, e):
    v.q += 0.1 * (e.head.q - v.q)  #~ E301


@ebb.kernel
def relax(v: vertices):
    for e in v.edges:
        pull(v, e)


relax(vertices)
