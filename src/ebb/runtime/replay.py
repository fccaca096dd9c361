"""What the machine code that replays a captured step is handed: a state, a table of operations, a table of buffers.

The state and each operation are arrays of 64-bit words. Fields are numbered; the table of buffers has the address of
the memory of each, which a launch copies into its argument block, and of which a swap exchanges two.
"""

from __future__ import annotations

from enum import IntEnum

OPERATIONS, COUNT, BUFFERS, RUNS, DRAWN, FAILED = range(6)
"""The state: the operations and how many there are; the buffers; how many runs of all of them are left; how many
launches have drawn random numbers; the operation that has failed."""

STATE_WORDS = 6

KIND = 0
"""The first word of an operation is its kind."""

OPERATION_WORDS = 5

BLOCK, PLACES, PLACE_COUNT, RANDOM_WORD = range(1, 5)
"""A launch: its argument block; the pairs of a word of the block and the number of the field whose address
goes there, and how many there are; the word for the number of the launch among those that draw, or ``NONE``."""

NONE = -1
"""No word."""

LEFT, RIGHT = 1, 2
"""A swap: the numbers of two fields."""

TARGET, SOURCE, BYTES = 1, 2, 3
"""A copy of some bytes, by which a global is set."""

TURN, TURNS, TABLE, LAUNCHES = range(4)
"""What runs together, an array that an operation points to: the next turn and how many there are, the table of turns,
and that of launches. A turn is one block through some launches."""

FIRST, BEHIND, NUMBER = range(3)
"""A turn: its first launch and the one behind its last, and the block. A launch: its argument block."""

TURN_WORDS, TOGETHER_WORDS = 3, 4

WHAT, FORK_BY, TEAM = 1, 2, 3
"""Launches that run together: what runs, OpenMP's entry, how many threads. Before it come those launches as PLACE,
which put the addresses of fields into their argument blocks."""

REPLAY = "ebb_replay"
"""``i64 REPLAY(state*)`` runs the operations until none or no run is left and returns 0, or 1 when a launch fails."""


class Kind(IntEnum):
    """The kinds of operations. A DRAW is a launch on no rows: it counts among those that draw, and that is all.

    TOGETHER stands for launches of which each block runs through all, before the next."""

    LAUNCH = 0
    SWAP = 1
    COPY = 2
    DRAW = 3
    TOGETHER = 4
    PLACE = 5
