from world import make_grid

import ebb

cells = make_grid(periodic=(True, False))


@ebb.kernel
def step(c: cells):
    i, j = ebb.coords(c)[0], ebb.coords(c)[1]
    c.new_T = ebb.row_at(cells, [i - 7, 2 * j]).T  #~ E403


step(cells)
