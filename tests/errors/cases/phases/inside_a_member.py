from world import make_grid

import ebb

cells = make_grid()


@cells.member
def slope(c):
    return c(1, 0).T - c(0, 0).T


@ebb.kernel
def step(c: cells):
    c.T += 0.1 * c.slope  #~ E301


cells.new_subset("inner", [slice(0, 3), slice(0, 5)])
step(cells.inner)
