from ebb.domains import Grid2D

Grid2D((64, 64), periodic=(True, False, False))  #~ E531
