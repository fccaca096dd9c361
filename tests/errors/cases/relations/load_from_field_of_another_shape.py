from world import make_mesh

vertices, edges = make_mesh()
vertices.q.load(vertices.mass)  #~ E510
