from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if ebb.dot([True, False], [v.fixed, True]):  #~ E220
        v.mass = 0


step(vertices)
