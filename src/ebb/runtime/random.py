"""Counter-based random numbers: Philox4x32-10, the same numbers on every backend and thread count.

A number is a pure function of seed, row identity, launch and draw: no row stores a state, and rows run in any order.
Source: J. Salmon, M. Moraes, R. Dror, D. Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from __future__ import annotations

import operator
from typing import Any, TypeAlias

import numpy as np

from ebb.records import record
from ebb.runtime.recording import refuse
from ebb.types.types import ScalarType, float32

Words: TypeAlias = tuple[Any, Any, Any, Any]

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
WEYL = (0x9E3779B9, 0xBB67AE85)
"""The round constants of Philox4x32: the multipliers, and what is added to the key after each round."""

_MASK = 0xFFFFFFFF


@record
class LaunchKey:
    """What all rows of one launch share: the seed (64 bits) and the number of the launch (32 bits) since it was set."""

    seed: int
    launch: int


@record(frozen=False)
class _Generator:
    """The one piece of state: the seed, and how many launches have drawn numbers since it was set."""

    seed: int = 0
    launches: int = 0


_generator = _Generator()


def seed(value: int) -> None:
    """Starts the random numbers of kernels anew. Before the first call the seed is 0.

    Args:
        value: any integer; its low 64 bits count.

    Raises:
        TypeError: ``value`` is no integer.
        BackendError: a step is being captured.
    """
    refuse("seeding the random numbers", "seed them before the with statement, or before the step runs")
    _generator.seed = operator.index(value) & 0xFFFFFFFFFFFFFFFF
    _generator.launches = 0


def next_launch() -> LaunchKey:
    """The key of a new launch. A backend takes one for each launch of a kernel that draws, and for no other."""
    key = present_key()
    _generator.launches += 1
    return key


def present_key() -> LaunchKey:
    """The key that the next launch that draws will get."""
    return LaunchKey(_generator.seed, _generator.launches & _MASK)


def go_on_from(launches: int) -> None:
    """Says how many launches have drawn since the seed was set, where machine code has counted them."""
    _generator.launches = launches


def philox(counter: Words, key: tuple[Any, Any]) -> Words:
    """Four random 32-bit words of a counter of four and a key of two; Python integers, or arrays of uint64."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(ROUNDS):
        p0, p1 = MULTIPLIERS[0] * c0, MULTIPLIERS[1] * c2
        c0, c1, c2, c3 = (p1 >> 32) ^ c1 ^ k0, p1 & _MASK, (p0 >> 32) ^ c3 ^ k1, p0 & _MASK
        k0, k1 = (k0 + WEYL[0]) & _MASK, (k1 + WEYL[1]) & _MASK
    return c0, c1, c2, c3


def draw(distribution: str, scalar: ScalarType, key: LaunchKey, row: int, number: int) -> Any:
    """The draw of that number, counted from 0, of a row of one launch, as a NumPy scalar.

    Args:
        distribution: ``rand``, uniform in [0, 1), or ``randn``, standard normal by Box and Muller.
        scalar: float32 or float64.
        key: of the launch.
        row: the row's identity.
        number: how many numbers the row has drawn before in this launch.
    """
    counter = (row & _MASK, row >> 32, key.launch, number & _MASK)
    words = philox(counter, (key.seed & _MASK, key.seed >> 32))
    u = uniform(words[0], words[1], scalar)
    if distribution == "rand":
        return u
    v = uniform(words[2], words[3], scalar)
    one, two, turn = (scalar.dtype.type(constant) for constant in (1.0, 2.0, 2.0 * np.pi))
    return np.sqrt(-two * np.log(one - u)) * np.cos(turn * v)


def uniform(first: int, second: int, scalar: ScalarType) -> Any:
    """A number in [0, 1) of 24 bits of ``first`` in float32, of 53 bits of both words in float64."""
    if scalar == float32:
        return np.float32((first >> 8) * 2.0**-24)
    return np.float64(((first << 32 | second) >> 11) * 2.0**-53)
