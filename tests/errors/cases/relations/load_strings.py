from world import make_mesh

vertices, edges = make_mesh()
vertices.mass.load("heavy")  #~ E507
