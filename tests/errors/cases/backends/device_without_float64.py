import ebb
from fake_opencl import one_device

cells = ebb.Relation("cells", size=4)
cells.new_field("u", ebb.float64)


@ebb.kernel
def double(c: cells):
    c.u *= 2


with one_device(extensions=""), ebb.backend("opencl"):
    double(cells)  #~ E613
