from ebb.domains import Grid2D

Grid2D((20, 6)).coarsen().coarsen()  #~ E534
