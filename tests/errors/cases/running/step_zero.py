from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def walk(v: vertices):
    for i in range(0, 3, v.count):  #~ E405
        v.mass += 1


walk(vertices)
