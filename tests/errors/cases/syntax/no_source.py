from world import make_mesh

import ebb

vertices, edges = make_mesh()
namespace = {"ebb": ebb, "vertices": vertices}
exec("@ebb.kernel\ndef step(v: vertices):\n    v.mass = 1.0\n", namespace)
namespace["step"](vertices)  #~ E101
