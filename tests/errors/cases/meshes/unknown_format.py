from pathlib import Path

import ebb
from ebb.domains import TriMesh

Path("mesh.xyz").write_text("0 0 0\n")
TriMesh.load("mesh.xyz")  #~ E702
