import ebb
from fake_opencl import machine

with machine():
    ebb.set_backend("opencl")  #~ E611
