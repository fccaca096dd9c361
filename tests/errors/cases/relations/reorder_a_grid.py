import ebb

cells = ebb.Relation("cells", shape=(4, 5))
cells.reorder()  #~ E520
