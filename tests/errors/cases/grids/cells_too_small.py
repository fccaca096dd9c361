from ebb.domains import Grid2D

Grid2D((1000, 1000), origin=1000, extent=0.01)  #~ E532
