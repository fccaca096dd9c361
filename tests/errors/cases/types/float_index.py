from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = v.q[1.5]  #~ E205


step(vertices)
