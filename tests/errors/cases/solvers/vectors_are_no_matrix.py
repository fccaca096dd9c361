import ebb
from ebb.domains import TetMesh

edges = TetMesh.box(1, 1, 1, self_edges=True).edges
edges.new_field("force", ebb.vec3d)
ebb.interop.bsr_matrix(edges.force, row=edges.tail, col=edges.head)  #~ E552
