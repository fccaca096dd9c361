from ebb.domains import Grid2D

Grid2D((64, 64), origin=(0, float("inf")))  #~ E531
