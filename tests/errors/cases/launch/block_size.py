from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = 1.0


step(vertices, block_size=2000)  #~ E266
