import ebb
from ebb.domains import TetMesh

TetMesh.box(1, 1, 1).save("box.off")  #~ E714
