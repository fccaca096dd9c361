from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.func
def limit(x):
    if x > 1:
        return 1 / x


@ebb.kernel
def step(v: vertices):
    v.mass = limit(v.mass)  #~ E223


step(vertices)
