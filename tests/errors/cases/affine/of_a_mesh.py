from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = ebb.affine(vertices, [[1, 1]], v).mass  #~ E228


step(vertices)
