from world import make_mesh

vertices, edges = make_mesh()
edges.head.load(-1)  #~ E509
