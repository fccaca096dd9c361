import ebb

cells = ebb.Relation("cells", shape=(2**32, 2**32))  #~ E505
