import numpy as np
from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = np.linalg.norm(v.q)  #~ E128


step(vertices)
