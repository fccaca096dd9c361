import ebb
from ebb.domains import TetMesh

points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
TetMesh.from_arrays(points, [[0, 1, 2, 3], [1, 2, 3, 4], [1, 2, 0, 3]])  #~ E719
