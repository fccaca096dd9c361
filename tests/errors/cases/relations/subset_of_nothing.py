from world import make_mesh

vertices, edges = make_mesh()
vertices.new_subset("some", "abc")  #~ E514
