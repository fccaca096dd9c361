import ebb
from world import make_mesh

vertices, edges = make_mesh()
nearest = ebb.Global(ebb.key(vertices), 0)  #~ E517
