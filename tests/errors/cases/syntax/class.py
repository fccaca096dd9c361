from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    class Body:  #~ E110
        mass = 1

    v.mass = Body.mass


step(vertices)
