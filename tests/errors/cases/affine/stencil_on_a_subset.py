from world import make_grid

import ebb

cells = make_grid()
cells.new_subset("upper", [slice(1, 4), slice(1, 4)])


@ebb.kernel
def diffuse(c: cells):
    c.new_T = c(1, 0).T - c(-1, 0).T  #~ E410


diffuse(cells.upper)
