from world import make_grid

import ebb

cells = make_grid()


@ebb.kernel
def step(c: cells):
    n = ebb.int32(c.T)
    c.new_T = c(n, 0).T  #~ E209


step(cells)
