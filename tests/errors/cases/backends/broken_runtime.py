from pathlib import Path

import ebb
from fake_opencl import machine
from ebb.runtime.opencl_runtime import Wheel

with machine(wheel=Wheel(Path("lib/libintelocl.so"), "libtbb.so.12: cannot open shared object file")):
    ebb.set_backend("opencl")  #~ E611
