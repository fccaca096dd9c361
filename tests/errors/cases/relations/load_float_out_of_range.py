from world import make_grid

import ebb

cells = make_grid()
cells.new_field("power", ebb.float32, init=lambda i, j: 10.0 ** (20 * i))  #~ E508
