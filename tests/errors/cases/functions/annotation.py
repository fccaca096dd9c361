from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.func
def kinetic(m: ebb.float32, qd: ebb.vec3f):
    return 0.5 * m * ebb.dot(qd, qd)


@ebb.kernel
def step(v: vertices):
    v.mass = kinetic(v.qd, v.mass)  #~ E202 E202


step(vertices)
