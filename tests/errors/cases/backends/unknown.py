import ebb

ebb.set_backend("gpu")  #~
