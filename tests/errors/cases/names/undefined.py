from world import make_mesh

import ebb

vertices, edges = make_mesh()
damping = 0.5


@ebb.kernel
def step(v: vertices):
    v.qd *= dampng  #~ E120


step(vertices)
