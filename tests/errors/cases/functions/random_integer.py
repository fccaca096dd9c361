from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.count = ebb.rand(ebb.int32)  #~ E231


step(vertices)
