from world import make_mesh

import ebb

vertices, _ = make_mesh()


@ebb.kernel
def show(v: vertices):
    print(v.mass)


with ebb.capture() as step:
    show(vertices)  #~ E607
