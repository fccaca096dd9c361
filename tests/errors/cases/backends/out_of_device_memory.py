import ebb
from fake_opencl import one_device

cells = ebb.Relation("cells", size=1000)
cells.new_field("u", ebb.float64)


@ebb.kernel
def double(c: cells):
    c.u *= 2


with one_device(global_mem_size=100_000), ebb.backend("opencl"):
    double(cells)  #~ E614
