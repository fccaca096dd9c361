from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    m = [[1.0, 2.0], [3.0, 4.0]]
    v.frame = v.frame @ m  #~ E201


step(vertices)
