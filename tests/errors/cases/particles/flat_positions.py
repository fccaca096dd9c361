from ebb.domains import Particles

Particles([0.5, 0.25])  #~ E540
