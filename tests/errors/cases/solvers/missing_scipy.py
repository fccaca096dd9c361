import sys

import ebb
from ebb.domains import TetMesh

edges = TetMesh.box(1, 1, 1, self_edges=True).edges
edges.new_field("weight", ebb.float64)
sys.modules["scipy"] = None  # as where it is not installed
ebb.interop.bsr_matrix(edges.weight, row=edges.tail, col=edges.head)  #~ E553
