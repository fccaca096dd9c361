from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.new_field("q", ebb.float32)  #~ E502
