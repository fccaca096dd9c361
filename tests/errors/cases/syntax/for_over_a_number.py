from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    for x in v.mass:  #~ E224
        v.count += 1


step(vertices)
