import ebb

ebb.set_backend("gpu")  #~ E601
