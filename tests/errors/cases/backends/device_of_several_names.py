import ebb
from fake_opencl import CPU, Device, Platform, machine

with machine(Platform("Intel(R) OpenCL", Device("Intel Arc A770"), Device("Intel Xeon", type=CPU)), Platform("Other", Device("Other GPU"))):
    ebb.set_backend("opencl", device="intel")  #~ E612
