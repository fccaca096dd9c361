import ebb
from ebb.domains import HexMesh

points = [[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]
HexMesh.from_arrays(points, [[0, 1, 2, 3, 4, 5, 6, 7]])  #~ E715
