# Independent errors are reported together.
from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = v.q  #~ E202
    speed = ebb.lenght(v.qd)  #~ E127
    v.qd = speed * v.q
    v.count = 1.5  #~ E202


step(vertices)
