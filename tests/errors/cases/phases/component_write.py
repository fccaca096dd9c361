from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def smooth(v: vertices):
    for e in v.edges:
        v.pos.x = e.head.pos.y  #~ E301


smooth(vertices)
