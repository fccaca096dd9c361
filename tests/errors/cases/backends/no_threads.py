import ebb

ebb.set_backend("cpu", threads=0)  #~ E603
