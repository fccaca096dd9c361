from world import make_grid

cells = make_grid()
cells.new_field("right", cells, init=lambda i, j: (i + 1, j))  #~ E509
