from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    m = [[1, 2], [3]]  #~ E204


step(vertices)
