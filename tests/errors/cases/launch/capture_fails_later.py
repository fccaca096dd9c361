from world import make_mesh

import ebb

vertices, edges = make_mesh()
period = 2.0


@ebb.kernel
def turn(v: vertices):
    v.mass = 6.28 / period


turn(vertices)
period = 0.0
turn(vertices)  #~ E264
