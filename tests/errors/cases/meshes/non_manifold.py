import ebb
from ebb.domains import TriMesh

points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
TriMesh.from_arrays(points, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])  #~ E709
