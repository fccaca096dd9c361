from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    match v.count:  #~ E110
        case 0:
            v.mass = 1.0


step(vertices)
