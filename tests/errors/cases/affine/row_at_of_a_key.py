from world import make_grid

import ebb

cells = make_grid()


@ebb.kernel
def step(c: cells):
    c.new_T = ebb.row_at(c, [0, 0]).T  #~ E233


step(cells)
