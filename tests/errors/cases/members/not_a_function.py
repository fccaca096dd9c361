from world import make_mesh

vertices, edges = make_mesh()
vertices.member("weight")(9.81)  #~
