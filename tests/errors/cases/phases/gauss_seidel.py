from world import make_grid

import ebb

cells = make_grid()


@ebb.kernel
def sweep(c: cells):
    c.T = 0.25 * (c(1, 0).T + c(-1, 0).T + c(0, 1).T + c(0, -1).T)  #~ E301


cells.new_subset("inner", [slice(1, 3), slice(1, 4)])
sweep(cells.inner)
