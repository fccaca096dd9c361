import ebb

ebb.Relation("cells", shape=(2, 2, 2, 2))  #~ E505
