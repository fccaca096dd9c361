from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    m = ebb.inverse([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])  #~ E220


step(vertices)
