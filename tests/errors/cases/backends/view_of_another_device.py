import ebb

cells = ebb.Relation("cells", size=4)
cells.new_field("u", ebb.float64)

with ebb.backend("cpu"):
    ebb.interop.opencl_array(cells.u)  #~ E619
