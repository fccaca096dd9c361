import ebb
from ebb.domains import TriMesh

TriMesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 1]])  #~ E707
