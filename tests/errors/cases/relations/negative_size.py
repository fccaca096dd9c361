import ebb

ebb.Relation("edges", size=-1)  #~
