import ebb
from ebb.domains import HexMesh

points = [[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]
HexMesh.from_arrays(points, [[0, 1, 3, 2, 4, 5, 7, 6], [1, 3, 2, 0, 5, 7, 6, 4]])  #~ E719
