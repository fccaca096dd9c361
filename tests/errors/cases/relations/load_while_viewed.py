from world import make_mesh

vertices, edges = make_mesh()
with vertices.q.view(write=True):
    vertices.swap("q", "pos")  #~ E512
