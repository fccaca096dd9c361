import ebb

vertices = ebb.Relation("vertices", size=4, reorder="never")  #~ E521
