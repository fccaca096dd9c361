"""A step is captured of a kernel that is in the cache; then the kernel would be another one, and a row fails."""

import numpy as np

import ebb
from ebb.backends import known


def program():
    vertices = ebb.Relation("vertices", size=3)
    vertices.new_field("pos", ebb.vec3d)
    axis = 0

    @ebb.kernel
    def check(v: vertices):
        assert v.pos[axis] < 1.0

    with ebb.capture() as step:
        check(vertices)
    axis = 1
    return vertices, step


state, known.package_state = known.package_state, lambda: "these"
try:
    program()
    vertices, step = program()
finally:
    known.package_state = state
vertices.pos.load(np.ones((3, 3)))
step.run(1)  #~ E267
