from world import make_mesh

import ebb

vertices, edges = make_mesh()
edges.new_subset("first", [0, 1])


@ebb.kernel
def step(v: vertices):
    v.mass = 1.0


step(edges.first)  #~ E261
