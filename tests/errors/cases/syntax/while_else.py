from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    while v.count < 3:
        v.count += 1
    else:
        v.count = 0  #~ E110


step(vertices)
