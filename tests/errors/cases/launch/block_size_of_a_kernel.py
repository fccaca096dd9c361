from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel(block_size="large")  #~ E266
def step(v: vertices):
    v.mass = 1.0
