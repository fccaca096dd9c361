import ebb
from ebb.domains import Grid2D

grid = Grid2D((4, 5))
grid.cells.new_field("dx", ebb.float64, init=0.0)
grid.cells.new_field("T", ebb.float64, init=0.0)


@ebb.kernel
def slope(c: grid.cells):
    c.dx = c(1, 0).T - c.T  #~ E410


slope(grid.cells)
