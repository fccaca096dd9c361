import ebb

with ebb.capture() as step:
    pass

step.run(0.1 / 0.01)  #~ E608
