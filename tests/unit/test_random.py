from __future__ import annotations

import numpy as np
import pytest

from ebb.runtime import random
from ebb.runtime.random import LaunchKey, draw, philox
from ebb.types.types import float32, float64

# The known answers of the authors' Random123 1.14, tests/kat_vectors, philox4x32 with 10 rounds.
KNOWN = (
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
)


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_known_answers(counter, key, words):
    assert philox(counter, key) == words
    arrays = philox(tuple(np.array([c], np.uint64) for c in counter), tuple(np.array([k], np.uint64) for k in key))
    assert tuple(int(word[0]) for word in arrays) == words


@pytest.mark.parametrize("scalar", [float32, float64])
def test_moments(scalar):
    key = LaunchKey(2**40 + 3, 5)
    uniform = np.array([draw("rand", scalar, key, row, 0) for row in range(4000)])
    normal = np.array([draw("randn", scalar, key, row, 0) for row in range(4000)])
    assert uniform.dtype == normal.dtype == scalar.dtype
    assert uniform.min() >= 0 and uniform.max() < 1
    assert uniform.mean() == pytest.approx(0.5, abs=0.02) and uniform.var() == pytest.approx(1 / 12, abs=0.005)
    assert normal.mean() == pytest.approx(0, abs=0.06) and normal.var() == pytest.approx(1, abs=0.08)
    assert np.all(np.isfinite(normal))


def test_every_part_of_the_counter_counts():
    base = draw("rand", float64, LaunchKey(1, 1), 1, 1)
    others = [
        draw("rand", float64, LaunchKey(2, 1), 1, 1),
        draw("rand", float64, LaunchKey(1 + 2**32, 1), 1, 1),
        draw("rand", float64, LaunchKey(1, 2), 1, 1),
        draw("rand", float64, LaunchKey(1, 1), 2, 1),
        draw("rand", float64, LaunchKey(1, 1), 1 + 2**32, 1),
        draw("rand", float64, LaunchKey(1, 1), 1, 2),
    ]
    assert len({base, *others}) == 7


def test_seed_starts_anew():
    random.seed(-1)
    assert random.next_launch() == LaunchKey(2**64 - 1, 0)
    assert random.next_launch() == LaunchKey(2**64 - 1, 1)
    random.seed(np.int64(3))
    assert random.next_launch() == LaunchKey(3, 0)
    with pytest.raises(TypeError):
        random.seed(0.5)
    random.seed(0)
