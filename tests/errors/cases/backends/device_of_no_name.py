import ebb
from fake_opencl import one_device

with one_device():
    ebb.set_backend("opencl", device="nvidia")  #~ E612
