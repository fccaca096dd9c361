from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def copy(v: vertices, dst: str, src: str):
    v[dst] = v[src]  #~ E127


copy(vertices, "q", "postion")
