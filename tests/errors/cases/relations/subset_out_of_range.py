from world import make_mesh

vertices, edges = make_mesh()
vertices.new_subset("some", [0, 4])  #~ E515
