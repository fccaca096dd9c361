from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.qd = ebb.cross([v.q.x, v.q.y], [1.0, 0.0])  #~ E220


step(vertices)
