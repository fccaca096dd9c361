import ebb

ebb.set_backend("cpu", reorder="never")  #~ E606
