from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    text = f"mass {v.mass}"  #~ E110
    print(text)


step(vertices)
