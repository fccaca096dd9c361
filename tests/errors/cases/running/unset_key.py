from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.new_field("parent", vertices)


@ebb.kernel
def follow(v: vertices):
    v.qd = v.parent.q  #~ E404


follow(vertices)
