from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    e.head.fixed += True  #~ E213


step(edges)
