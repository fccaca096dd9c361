from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices, direction: ebb.vec3f):
    v.q += direction


step(vertices, [1.0, 2.0])  #~ E263
