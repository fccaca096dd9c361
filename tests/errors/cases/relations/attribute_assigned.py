from world import make_mesh

vertices, edges = make_mesh()
vertices.mass = 2.0  #~ E516
