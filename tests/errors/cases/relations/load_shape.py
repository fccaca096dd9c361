from world import make_mesh

vertices, edges = make_mesh()
vertices.q.load([[0.0, 1.0], [2.0, 3.0]])  #~ E506
