from world import make_mesh

vertices, edges = make_mesh()
vertices.charge = 1.0  #~ E516
