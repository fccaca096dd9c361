import ebb
from ebb.domains import TetMesh
from ebb.solvers import ConjugateGradients

mesh = TetMesh.box(1, 1, 1, self_edges=True)
mesh.vertices.new_field("u", ebb.float64)
mesh.vertices.new_field("f", ebb.float64)
mesh.edges.new_field("a", ebb.float64)
ConjugateGradients(mesh.vertices.u, mesh.vertices.f, mesh.edges.a, preconditioner="diagonal")  #~ E551
