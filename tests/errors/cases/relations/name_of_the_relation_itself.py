import ebb

vertices = ebb.Relation("vertices", size=4)
vertices.new_field("size", ebb.float64)  #~ E502
