import ebb
from fake_opencl import Device, Platform, machine

with machine(Platform("Old", Device("GPU of 2012", il_version="")), Platform("New", Device("GPU of 2022"))):
    ebb.set_backend("opencl", device=0)  #~ E613
