from world import make_mesh

vertices, edges = make_mesh()
vertices.member("density")(1.0)  #~ E519
