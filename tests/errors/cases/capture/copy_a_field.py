from world import make_mesh

import ebb

vertices, _ = make_mesh()

with ebb.capture() as step:
    vertices.copy("pos", "q")  #~ E607
