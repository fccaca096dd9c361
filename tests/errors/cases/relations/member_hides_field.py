from world import make_mesh

vertices, edges = make_mesh()


@vertices.member("mass")  #~ E502
def weight(v):
    return 9.81 * v.mass
