from world import make_mesh

vertices, edges = make_mesh()
print(vertices.mas)  #~ E503
