import ebb
from fake_opencl import Device, Platform, machine

cells = ebb.Relation("cells", size=100)
cells.new_field("u", ebb.float64)


@ebb.kernel
def double(c: cells):
    c.u *= 2


gpu = Device("Fake GPU")
with machine(Platform("Fake Platform", gpu)), ebb.backend("opencl"):
    double(cells)
    gpu.fails["clEnqueueCopyBuffer"] = "DEVICE_NOT_AVAILABLE"  # it runs out of power
    cells.u.view()  #~ E617
