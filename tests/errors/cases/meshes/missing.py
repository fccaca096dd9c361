import ebb
from ebb.domains import TetMesh

TetMesh.load("dragon.veg")  #~ E701
