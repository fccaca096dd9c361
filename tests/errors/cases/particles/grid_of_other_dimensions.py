from ebb.domains import Grid3D, Particles

particles = Particles([[0.5, 0.5]])
particles.couple(Grid3D((8, 8, 8)))  #~ E542
