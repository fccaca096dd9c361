import ebb
from ebb.domains import TriMesh

points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]]
TriMesh.from_arrays(points, [[0, 1, 2], [0, 1, 3]])  #~ E710
