from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    try:  #~ E110
        v.mass = 1 / v.mass
    except ZeroDivisionError:
        v.mass = 0


step(vertices)
