from world import make_mesh

import ebb

vertices, edges = make_mesh()
scale = 2.0


@ebb.kernel
def step(v: vertices):
    v.mass *= scale  #~ E122
    scale = 3.0


step(vertices)
