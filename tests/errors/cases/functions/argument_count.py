from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.func
def lerp(a, b, t):
    return a + t * (b - a)


@ebb.kernel
def step(v: vertices):
    v.mass = lerp(v.mass, 1.0)  #~ E221


step(vertices)
