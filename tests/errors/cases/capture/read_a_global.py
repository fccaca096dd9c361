from world import make_mesh

import ebb

vertices, _ = make_mesh()
total = ebb.Global(ebb.float32, 0.0)


@ebb.kernel
def weigh(v: vertices):
    total.value += v.mass


with ebb.capture() as step:
    weigh(vertices)
    print(total.value)  #~ E607
