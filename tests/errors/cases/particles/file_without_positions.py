import numpy as np

from ebb.domains import Particles

np.savez("dust.npz", x=np.zeros((2, 2)))
Particles.load("dust.npz")  #~ E702
