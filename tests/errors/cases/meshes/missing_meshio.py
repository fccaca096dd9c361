import sys
from pathlib import Path

from ebb.domains import TetMesh

sys.modules["meshio"] = None  # as where it is not installed
Path("body.vtu").write_text("")
TetMesh.load("body.vtu")  #~ E713
