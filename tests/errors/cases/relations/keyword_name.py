import ebb

vertices = ebb.Relation("vertices", size=4)
vertices.new_subset("lambda", [0])  #~ E501
