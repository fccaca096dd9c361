import ebb

ebb.Relation("cells", shape=(4, 4), periodic=(True, False, True))  #~ E505
