import ebb
from fake_opencl import CPU, Device, Platform, machine

with machine(Platform("Old", Device("GPU of 2012", il_version="")), Platform("Small", Device("Board", type=CPU, address_bits=32))):
    ebb.set_backend("opencl")  #~ E611
