# Independent errors are reported together.
from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = v.q  #~
    speed = ebb.lenght(v.qd)  #~
    v.qd = speed * v.q
    v.count = 1.5  #~


step(vertices)
