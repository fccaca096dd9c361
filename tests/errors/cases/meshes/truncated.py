from pathlib import Path

import ebb
from ebb.domains import TriMesh

Path("mesh.off").write_text("OFF\n4 4 0\n0 0 0\n1 0 0\n")
TriMesh.load("mesh.off")  #~ E704
