import ebb

with ebb.capture() as outer:
    with ebb.capture() as inner:  #~ E607
        pass
