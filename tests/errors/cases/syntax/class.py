from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    class Body:  #~
        mass = 1

    v.mass = Body.mass


step(vertices)
