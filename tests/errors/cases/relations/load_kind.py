from world import make_mesh

vertices, edges = make_mesh()
vertices.count.load([0.5, 1.0, 1.5, 2.0])  #~ E507
