import ebb

ebb.set_backend("cpu", thread=2)  #~ E602
