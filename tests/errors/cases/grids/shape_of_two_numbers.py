from ebb.domains import Grid3D

Grid3D((64, 64))  #~ E530
