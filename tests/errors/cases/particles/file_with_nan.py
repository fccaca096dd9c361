import numpy as np

from ebb.domains import Particles

np.savez("dust.npz", pos=[[0.5, 0.5], [0.5, np.nan]])
Particles.load("dust.npz")  #~ E706
