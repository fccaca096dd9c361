import ebb
from ebb.domains import Grid2D

grid = Grid2D((4, 5), periodic=(True, False))
grid.cells.new_field("T", ebb.float64, init=0.0)
grid.cells.new_field("new_T", ebb.float64, init=0.0)


@ebb.kernel
def step(c: grid.cells):
    c.new_T = c.yneg.T + c.ypos.T  #~ E410 E410


step(grid.cells)
