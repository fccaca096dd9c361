from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    print(v.mass, end="")  #~ E117


step(vertices)
