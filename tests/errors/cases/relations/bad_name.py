import ebb

ebb.Relation("my edges", size=3)  #~
