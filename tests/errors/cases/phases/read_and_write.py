from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def smooth(v: vertices):
    total = ebb.vec3f(0)
    for e in v.edges:
        total += e.head.pos
    v.pos = total / 2  #~ E301


smooth(vertices)
