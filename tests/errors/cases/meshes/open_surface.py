import ebb
from ebb.domains import TetMesh

TetMesh.from_surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], resolution=4)  #~ E711
