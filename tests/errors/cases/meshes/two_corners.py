import ebb
from ebb.domains import PolyMesh

PolyMesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [2, 0]])  #~ E718
