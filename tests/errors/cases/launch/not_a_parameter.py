from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices, settings):
    v.mass = settings


step(vertices, {"mass": 1.0})  #~ E263
