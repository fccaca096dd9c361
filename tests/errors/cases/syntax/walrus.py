from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if (m := v.mass) > 0:  #~ E110
        v.mass = m / 2


step(vertices)
