import ebb
from ebb.domains import TetMesh

box = TetMesh.box(1, 1, 2)
cells = box.tetrahedra.v.to_numpy()
cells[3:5] = cells[3:5, [0, 2, 1, 3]]
# Were all inverted, they would be turned.
TetMesh.from_arrays(box.vertices.pos, cells, fix_orientation=None)  #~ E708
