"""Starts processes that write a cache and kills each of them at some moment of it: ``SOURCE TARGET COUNT``.

What they write is what lies in the cache ``SOURCE``. Prints how many files were left half written.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

from ebb.backends import cache as caching
from ebb.backends.cache import ObjectCache


def write_until_killed(target: ObjectCache, pieces: dict[str, bytes], turn: int) -> None:
    """Every second process stops by itself half-way through a file, which chance would not often hit."""
    if turn % 2:
        caching._write = write_half_and_die
    while True:
        for key, image in pieces.items():
            target.put(key, image)


def write_half_and_die(path: str, content: bytes) -> None:
    with open(path, "xb") as file:
        file.write(content[: random.randrange(len(content))])
    os.kill(os.getpid(), signal.SIGKILL)


def main(source: str, target: str, count: str) -> None:
    cache = ObjectCache(Path(source))
    keys = [path.stem for path in cache.directory.glob("*.o")]
    pieces = {key: cache.get(key) for key in keys}
    assert keys and all(pieces.values())
    for turn in range(int(count)):
        random.seed(turn)
        process = os.fork()
        if process == 0:
            write_until_killed(ObjectCache(Path(target)), pieces, turn)
        time.sleep(random.uniform(0.0, 0.004))
        os.kill(process, signal.SIGKILL)
        assert os.waitpid(process, 0)[1] == signal.SIGKILL
    left = ObjectCache(Path(target))
    for path in left.directory.glob("*.o"):
        assert left.get(path.stem) == pieces[path.stem], "a file under its own name is whole"
    print(len(list(left.directory.glob("*.part"))))


if __name__ == "__main__":
    main(*sys.argv[1:])
