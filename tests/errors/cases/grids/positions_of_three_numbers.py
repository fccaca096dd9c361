import ebb
from ebb.domains import Grid2D

grid = Grid2D((4, 4))
particles = ebb.Relation("particles", size=10)
particles.new_field("pos", ebb.vec3f)
particles.new_field("cell", grid.cells)
grid.cells.point_locate(particles.cell, particles.pos)  #~ E535
