# The second line was meant to go on with the first: an expression that does nothing.
from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.q += 0.1 * v.qd
    +0.5 * v.force  #~ E111


step(vertices)
