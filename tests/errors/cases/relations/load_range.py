from world import make_mesh

vertices, edges = make_mesh()
vertices.count.load([0, 1, 2**40, 3])  #~ E508
