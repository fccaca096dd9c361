from world import make_mesh

vertices, edges = make_mesh()


@vertices.member
def weight(v):
    return 9.81 * v.mass


@weight.reducer("-")  #~ E518
def lighten(v, value):
    v.mass -= value / 9.81
