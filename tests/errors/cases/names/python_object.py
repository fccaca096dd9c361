from world import make_mesh

import ebb

vertices, edges = make_mesh()
settings = {"gravity": 9.81}


@ebb.kernel
def step(v: vertices):
    v.mass *= settings  #~ E125


step(vertices)
