from ebb.domains import Grid2D

Grid2D((64, 0))  #~ E530
