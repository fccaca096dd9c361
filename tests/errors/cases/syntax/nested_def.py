from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    def double(x):  #~ E110
        return 2 * x

    v.mass = double(v.mass)


step(vertices)
