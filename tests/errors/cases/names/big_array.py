import numpy as np
from world import make_mesh

import ebb

vertices, edges = make_mesh()
table = np.zeros(1000)


@ebb.kernel
def step(v: vertices):
    v.mass = table[v.count]  #~ E202


step(vertices)
