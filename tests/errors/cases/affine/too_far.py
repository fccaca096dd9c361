from world import make_grid

import ebb

cells = make_grid()


@ebb.kernel
def shift(c: cells):
    c.new_T = c(9, 0).T  #~ E410


shift(cells)
