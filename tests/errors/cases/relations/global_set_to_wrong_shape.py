import ebb

momentum = ebb.Global(ebb.vec3d, 0)
momentum.value = [1, 2]  #~ E506
