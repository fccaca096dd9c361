from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = 2.0


with vertices.mass.view(write=True) as mass:
    mass[:] = 1.0
    step(vertices)  #~ E512
