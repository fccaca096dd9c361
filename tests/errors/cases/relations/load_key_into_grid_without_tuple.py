from world import make_grid, make_mesh

cells = make_grid()
vertices, edges = make_mesh()
vertices.new_field("cell", cells, init=[0, 1, 2, 3])  #~ E506
