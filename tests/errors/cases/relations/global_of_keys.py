from world import make_mesh

import ebb

vertices, edges = make_mesh()
ebb.Global(vertices, 0)  #~
