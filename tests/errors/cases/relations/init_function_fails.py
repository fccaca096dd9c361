from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.new_field("rest", ebb.vec3f, init=lambda i: [i, i])  #~ E506
