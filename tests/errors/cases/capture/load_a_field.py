from world import make_mesh

import ebb

vertices, _ = make_mesh()

with ebb.capture() as step:
    vertices.force.load(0.0)  #~ E607
