from world import make_mesh

import ebb

vertices, edges = make_mesh()


def double(x):
    return 2 * x


@ebb.kernel
def step(v: vertices):
    v.mass = double(v.mass)  #~ E128


step(vertices)
