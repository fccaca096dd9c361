from ebb.domains import Grid2D

Grid2D((64, 4), boundary_depth=5)  #~ E533
