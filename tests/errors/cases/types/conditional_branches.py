from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.q = v.q if v.fixed else v.mass  #~ E212


step(vertices)
