from world import make_mesh

import ebb

vertices, edges = make_mesh()
E = ebb.Global(ebb.float64, 0.0)


@ebb.kernel
def measure(v: vertices):
    E.value = max(v.mass, 1.0)  #~ E302


measure(vertices)
