from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    double = lambda x: 2 * x  #~ E110
    v.mass = double(v.mass)


step(vertices)
