from ebb.domains import Grid2D

Grid2D((64, 64), origin=(1, 1), extent=(2, -2))  #~ E532
