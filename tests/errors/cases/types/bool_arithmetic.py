from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass += v.fixed * 2.0  #~ E201


step(vertices)
