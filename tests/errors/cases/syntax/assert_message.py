from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    assert v.mass > 0, v.mass  #~ E116


step(vertices)
