import numpy as np
from world import make_grid

cells = make_grid()
cells.new_subset("right", np.s_[4, :])  #~ E515
