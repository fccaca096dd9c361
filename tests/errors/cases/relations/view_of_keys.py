from world import make_mesh

vertices, edges = make_mesh()
with edges.head.view(write=True) as head:  #~ E513
    head[:] = 0
