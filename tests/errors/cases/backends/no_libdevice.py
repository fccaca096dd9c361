from unittest.mock import patch

import ebb
from ebb.backends.llvm import libdevice

cells = ebb.Relation("cells", size=4)
cells.new_field("u", ebb.float64)


@ebb.kernel
def wave(c: cells):
    c.u = ebb.exp(-c.u) * ebb.sin(c.u)


with patch.object(libdevice, "find_libdevice", return_value=None):
    wave.inspect(cells, "ptx")  #~ E618
