from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step():  #~ E106
    pass


step(vertices)
