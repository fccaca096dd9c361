import numpy as np
from world import make_grid

cells = make_grid()
cells.T.load(np.zeros((5, 4)))  #~ E506
