import ebb

vertices = ebb.Relation("vertices", size=-1)  #~ E505
