from pathlib import Path

import ebb
from ebb.domains import TriMesh

Path("mesh.off").mkdir()
TriMesh.load("mesh.off")  #~ E701
