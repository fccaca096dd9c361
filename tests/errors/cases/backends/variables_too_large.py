import ebb

images = ebb.Relation("images", size=1)
images.new_field("pixels", ebb.matrix(ebb.float64, 400, 400))
images.new_field("column", ebb.int32)
images.new_field("corner", ebb.float64)


@ebb.kernel
def pick(i: images):
    pixels = i.pixels
    i.corner = pixels[0, i.column]


with ebb.backend("cpu"):
    pick(images)  #~ E605
