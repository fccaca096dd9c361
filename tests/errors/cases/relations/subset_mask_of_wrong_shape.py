import numpy as np
from world import make_grid

cells = make_grid()
cells.new_subset("hot", np.zeros(20, dtype=bool))  #~ E514
