from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    m = v.mass
    del m  #~ E110


step(vertices)
