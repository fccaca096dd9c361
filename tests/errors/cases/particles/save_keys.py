from ebb.domains import Grid2D, Particles

dust = Particles([[0.5, 0.5]])
dust.couple(Grid2D((8, 8)))
dust.save("dust.npz", ["cell"])  #~ E714
