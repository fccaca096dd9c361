import ebb

with ebb.capture() as inner:
    pass

with ebb.capture() as outer:
    inner.run(10)  #~ E607
