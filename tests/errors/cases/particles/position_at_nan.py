from ebb.domains import Particles

Particles([[0.5, 0.5], [0.5, float("nan")]])  #~ E541
