from world import make_grid

import ebb

cells = make_grid()
cells.T.load(lambda i, j: 1.0 if (i, j) == (2, 3) else 0.0)


@ebb.kernel
def check(c: cells):
    assert c.T < 1, "too hot"  #~ E401


check(cells)
