from world import make_grid

import ebb

cells = make_grid()


@ebb.kernel
def diffuse(c: cells):
    c.new_T = 0.25 * (c(1, 0).T + c(-1, 0).T + c(0, 1).T + c(0, -1).T)  #~ E410 E410 E410 E410


diffuse(cells)
