from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.count.load([0, 1, 2, 3])


@ebb.kernel
def pick(v: vertices):
    v.mass = v.q[v.count]  #~ E402


pick(vertices)
