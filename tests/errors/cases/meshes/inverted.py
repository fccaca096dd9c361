import ebb
from ebb.domains import TetMesh

TetMesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1, 3]])  #~ E708
