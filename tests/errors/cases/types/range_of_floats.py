from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    for i in range(v.mass):  #~ E232
        v.count += i


step(vertices)
