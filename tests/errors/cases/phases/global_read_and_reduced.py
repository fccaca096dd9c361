from world import make_mesh

import ebb

vertices, edges = make_mesh()
E = ebb.Global(ebb.float64, 0.0)


@ebb.kernel
def measure(v: vertices):
    E.value += v.mass  #~ E304
    v.mass = ebb.float32(E.value)


measure(vertices)
