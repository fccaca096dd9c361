from world import make_mesh

import ebb

vertices, edges = make_mesh()
text = "def step(v):\n    v.mass = " + " + ".join(["v.mass"] * 500)
names = {}
exec(text, names)
ebb.kernel(source=text)(names["step"])(vertices)  #~ E118
