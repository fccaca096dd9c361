from ebb.domains import Grid2D, Particles

particles = Particles([[0.5, 0.5]])
particles.couple(Grid2D((1, 8)))  #~ E542
