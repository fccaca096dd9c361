from world import make_mesh

import ebb

vertices, edges = make_mesh()
total = 0.0


@ebb.kernel
def step(v: vertices):
    global total  #~ E110
    total += v.mass  #~ E123


step(vertices)
