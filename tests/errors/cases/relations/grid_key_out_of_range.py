from world import make_grid, make_mesh

vertices, edges = make_mesh()
cells = make_grid()
vertices.new_field("cell", cells, init=[[0, 0], [1, 1], [4, 0], [2, 2]])  #~ E509
