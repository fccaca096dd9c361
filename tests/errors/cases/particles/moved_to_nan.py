import ebb
from ebb.domains import Grid2D, Particles

dust = Particles([[0.5, 0.5], [2.5, 0.0]])
dust.couple(Grid2D((8, 8)))
dust.pos.load([[0.5, 0.5], [2.5, float("nan")]])
dust.locate()  #~ E401
