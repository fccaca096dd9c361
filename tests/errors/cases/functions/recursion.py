from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.func
def even(n):
    return True if n == 0 else odd(n - 1)


@ebb.func
def odd(n):
    return False if n == 0 else even(n - 1)  #~ E129


@ebb.kernel
def step(v: vertices):
    v.fixed = even(v.count)


step(vertices)
