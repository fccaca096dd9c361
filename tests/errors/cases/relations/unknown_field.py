from world import make_mesh

vertices, edges = make_mesh()
vertices.swap("q", "postion")  #~ E503
