from world import make_mesh

vertices, edges = make_mesh()
vertices.copy(edges.rest_len, vertices.mass)  #~ E504
