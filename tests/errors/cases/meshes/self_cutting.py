import numpy as np

from ebb.domains import TetMesh

corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
TetMesh.from_surface(  #~ E726
    np.concatenate([corners, corners * 0.8 + 0.15]), np.concatenate([faces, faces + 4]), method="conforming"
)
