"""Four small kernels and what they must compute: prints "right" if they do. Run in processes that share a cache."""

from __future__ import annotations

import numpy as np

import ebb

SIZE = 100

rows = ebb.Relation("rows", size=SIZE)
rows.new_field("x", ebb.float32, init=np.arange(SIZE))
rows.new_field("y", ebb.float32)
rows.new_field("next", rows, init=(np.arange(SIZE) + 1) % SIZE)
total = ebb.Global(ebb.int64, 0)


@ebb.kernel
def double(r: rows):
    r.y = 2.0 * r.x


@ebb.kernel
def shift(r: rows):
    r.y += r.next.x


@ebb.kernel
def clamp(r: rows):
    if r.y > 100.0:
        r.y = 100.0


@ebb.kernel
def count(r: rows):
    total.value += ebb.int64(r.y)


def main() -> None:
    for kernel in (double, shift, clamp, count):
        kernel(rows)
    x = np.arange(SIZE)
    expected = np.minimum(2 * x + (x + 1) % SIZE, 100)
    assert (rows.y.to_numpy() == expected).all()
    assert total.value == expected.sum()
    print("right")


if __name__ == "__main__":
    main()
