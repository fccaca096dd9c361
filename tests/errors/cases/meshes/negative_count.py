from pathlib import Path

import ebb
from ebb.domains import TriMesh

Path("mesh.off").write_text("OFF\n-3 1 0\n")
TriMesh.load("mesh.off")  #~ E703
