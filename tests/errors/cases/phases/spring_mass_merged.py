# The kernels of the spring-mass program in one: rows would read positions that others have moved already.
from world import make_mesh

import ebb

vertices, edges = make_mesh()
dt = 1e-3
K = ebb.constant(1.0, ebb.float32)


@ebb.kernel
def step(v: vertices):
    for e in v.edges:
        dq = e.head.q - v.q
        v.force += K * (e.rest_len * ebb.normalize(dq) - dq)
    qdd = v.force / v.mass
    v.q += v.qd * dt + 0.5 * qdd * dt * dt  #~ E301
    v.qd += qdd * dt
    v.force = [0, 0, 0]


step(vertices)
