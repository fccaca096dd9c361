from world import make_mesh

vertices, edges = make_mesh()
edges.group_by("haed")  #~ E503
