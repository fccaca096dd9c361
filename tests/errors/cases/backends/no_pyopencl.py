import ebb
from fake_opencl import without_pyopencl

with without_pyopencl():
    ebb.set_backend("opencl")  #~ E610
