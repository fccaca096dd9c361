import ebb
from ebb.domains import Grid3D

Grid3D((2**21, 2**21, 2**21), precision=ebb.float64)  #~ E505
