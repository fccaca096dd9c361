from world import make_mesh

vertices, edges = make_mesh()
vertices.fixed.load([0, 1, 0, 1])  #~ E507
