from pathlib import Path

import ebb
from ebb.domains import PolyMesh

Path("mesh.off").write_text("OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n4 0 2 3\n")
PolyMesh.load("mesh.off")  #~ E703
