import ebb

vertices = ebb.Relation("vertices", size=4)
vertices.new_field("rest length", ebb.float32)  #~ E501
