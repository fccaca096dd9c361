from pathlib import Path

from world import make_mesh

import ebb

vertices, edges = make_mesh()
program = """
@ebb.kernel
def step(v: vertices):
    v.mass = 1.0
"""
namespace = {"ebb": ebb, "vertices": vertices}
exec(compile(program, "edited.py", "exec"), namespace)
Path("edited.py").write_text("# edited after it was run\n")
namespace["step"](vertices)  #~ E103
