from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    assert v.q >= 0, "outside"  #~ E211


step(vertices)
