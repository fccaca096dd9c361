import ebb
from ebb.domains import TetMesh
from ebb.solvers import ConjugateGradients

mesh = TetMesh.box(1, 1, 1, self_edges=True)
mesh.vertices.new_field("dv", ebb.vec3d)
mesh.vertices.new_field("force", ebb.vec3d)
mesh.edges.new_field("stiffness", ebb.float64)
ConjugateGradients(mesh.vertices.dv, mesh.vertices.force, mesh.edges.stiffness)  #~ E550
