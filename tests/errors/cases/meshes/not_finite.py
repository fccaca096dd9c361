from pathlib import Path

import ebb
from ebb.domains import TriMesh

Path("mesh.off").write_text("OFF\n3 1 0\n0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n")
TriMesh.load("mesh.off")  #~ E706
