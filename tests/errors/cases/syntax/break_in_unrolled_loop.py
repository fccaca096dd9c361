from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    for i in (0, 1, 2):
        if v.q[i] < 0:
            break  #~
        v.mass += v.q[i]


step(vertices)
