import sys

from ebb.domains import TetMesh, TriMesh

sys.modules["tetgen"] = None  # as where it is not installed
TetMesh.from_surface(TriMesh.box(1, 1, 1), method="conforming")  #~ E725
