from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    if v.mass < 0:
        raise ValueError("negative mass")  #~ E110


step(vertices)
