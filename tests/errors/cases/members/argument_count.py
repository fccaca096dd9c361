from world import make_grid

import ebb

cells = make_grid()


@ebb.kernel
def step(c: cells):
    c.new_T = c(1).T  #~ E221


step(cells)
