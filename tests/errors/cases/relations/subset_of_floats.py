from world import make_mesh

vertices, edges = make_mesh()
vertices.new_subset("top", [0.0, 1.0])  #~ E514
