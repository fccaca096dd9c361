"""The regions of LULESH 2.0: which zones are of which, and how much work each is.

The reference draws them by chance, so that they lie scattered through the mesh in runs of zones (Karlin, Keasler and
Neely, "LULESH 2.0 Updates and Changes", LLNL-TR-641973). The gas is the same in all.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator

import numpy as np


def random_numbers() -> Iterator[int]:
    """The numbers of ``rand()`` of the GNU C library after ``srand(0)``, by which the reference draws its regions.

    Each is the sum of those 3 and 31 before it (Knuth, "The Art of Computer Programming" 2, section 3.2.2).
    """
    last = deque([1], maxlen=34)
    for _ in range(30):
        last.append(16807 * last[-1] % (2**31 - 1))
    last.extend(list(last)[:3])
    for count in itertools.count():
        last.append((last[-3] + last[-31]) % 2**32)
        if count >= 310:
            yield last[-1] >> 1


RUNS = ((773, 1, 15), (937, 16, 16), (970, 32, 32), (974, 64, 64), (978, 128, 128), (981, 256, 256), (1000, 512, 1537))
"""The lengths of runs of zones in one region: up to how many of 1000, the shortest, and how many lengths."""


def draw_regions(zones: int, regions: int, balance: int) -> np.ndarray:
    """The region of each zone, as the reference draws them: runs of random lengths, of another region than the last.

    Region r is drawn in proportion to (r + 1) ** balance.
    """
    region_of = np.zeros(zones, dtype=np.int64)
    if regions == 1:
        return region_of
    draw = random_numbers()
    ends = np.cumsum([int((r + 1) ** balance) for r in range(regions)])
    start, last = 0, -1
    while start < zones:
        region = last
        while region == last:
            region = int(np.searchsorted(ends, next(draw) % int(ends[-1]), side="right"))
        chance = next(draw) % 1000
        shortest, lengths = next((low, count) for limit, low, count in RUNS if chance < limit)
        stop = start + shortest + next(draw) % lengths
        region_of[start:stop] = region
        start, last = stop, region
    return region_of


def evaluations(region: int, regions: int, cost: int) -> int:
    """How often a region evaluates its gas: half of all once, others 1 + cost times, one in twenty ten times that."""
    if region < regions // 2:
        return 1
    return (1 if region < regions - (regions + 15) // 20 else 10) * (1 + cost)
