import ebb

vertices = ebb.Relation("vertices", size=3)
vertices.new_field("mass", ebb.float32)
springs = ebb.Relation("springs", size=2)
springs.new_field("head", vertices, init=[0, 2])
springs.new_field("tail", vertices, init=[2, 1])
with vertices.mass.view(write=True):
    vertices.reorder()  #~ E512
