from world import make_mesh

import ebb

vertices, edges = make_mesh()
step = ebb.kernel(lambda v: v.mass)
step(vertices)  #~ E102
