from world import make_grid, make_mesh

import ebb

vertices, edges = make_mesh()
cells = make_grid()
vertices.new_field("cell", cells, init=[[1, 1], [2, 2], [3, 3], [0, 0]])


@ebb.kernel
def gather(v: vertices):
    v.mass = ebb.float32(v.cell(1, 0).T)  #~ E403


gather(vertices)
