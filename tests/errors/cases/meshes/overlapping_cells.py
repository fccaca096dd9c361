import ebb
from ebb.domains import PolyMesh

points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
faces = [[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]]
PolyMesh.from_arrays(points, faces, [[0, 1, 2, 3], [3, 2, 1, 0]])  #~ E717
