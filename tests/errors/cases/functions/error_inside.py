# The error is in the function; the call that led there is shown with it.
from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.func
def stretch(e):
    return e.rest_length - 1.0  #~ E127


@ebb.kernel
def step(v: vertices):
    for e in v.edges:
        v.mass += stretch(e)


step(vertices)
