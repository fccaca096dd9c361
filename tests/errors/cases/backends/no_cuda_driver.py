import sys
from types import SimpleNamespace

import ebb


def init(flags):
    raise RuntimeError("Failed to dlopen libcuda.so.1")


sys.modules["cuda.bindings.driver"] = SimpleNamespace(cuInit=init)
ebb.set_backend("cuda", device=0)  #~ E611
