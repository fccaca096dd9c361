from world import make_mesh

vertices, edges = make_mesh()
edges.head.load([0, 1, 2, 3, 4, 5, 6, 7])  #~ E509
