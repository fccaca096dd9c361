"""Translates LLVM modules to SPIR-V, in a process of its own.

LLVM's SPIR-V target keeps pointers into a module after it is done with it, and gets the next one of the process wrong
by them, now and then; and what it does not know it answers by ending the process. So a process that has translated
nothing yet forks one for each module, which ends then. Where there is no fork, it ends itself.

This file is run as a script, which knows nothing of Ebb: the arguments are where to look for modules.
"""

from __future__ import annotations

import os
import signal
import struct
import sys
import tempfile
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from collections.abc import Callable

REQUEST = struct.Struct("<cQ")
"""Before a module, as bitcode: what to make of it, and how long it is."""

ANSWER = struct.Struct("<?Q")
"""Before an answer: whether it is the translation, and how long it is. Otherwise it says what is wrong."""

BINARY, TEXT = b"b", b"t"
"""What to make of a module."""

FORKS = hasattr(os, "fork")
"""Whether there is a fork; else the process ends after an answer."""


def serve(extensions: str) -> None:
    """Answers requests, until there are no more."""
    import llvmlite.binding as llvm

    llvm.set_option("ebb", f"--spirv-ext={extensions}")
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()

    def translate(kind: bytes, bitcode: bytes) -> bytes:
        module = llvm.parse_bitcode(bitcode)
        # Not optimised again: the loop passes before instruction selection make counters of odd widths, two bits say.
        machine = llvm.Target.from_triple(module.triple).create_target_machine(opt=0)
        return bytes(machine.emit_object(module) if kind == BINARY else machine.emit_assembly(module).encode())

    asked, answered = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    while header := asked.read(REQUEST.size):
        kind, size = REQUEST.unpack(header)
        bitcode = asked.read(size)
        done, answer = _forked(translate, kind, bitcode) if FORKS else (True, translate(kind, bitcode))
        answered.write(ANSWER.pack(done, len(answer)) + answer)
        answered.flush()
        if not FORKS:
            return


def _forked(translate: Callable[[bytes, bytes], bytes], kind: bytes, bitcode: bytes) -> tuple[bool, bytes]:
    """What another process makes of a module, or what it said when it failed."""
    with tempfile.TemporaryFile() as translated, tempfile.TemporaryFile() as complaints:
        child = os.fork()
        if child == 0:
            _translate(translate, kind, bitcode, translated, complaints)
        _, status = os.waitpid(child, 0)
        chosen = translated if status == 0 else complaints
        chosen.seek(0)
        return status == 0, chosen.read()


def _translate(
    translate: Callable[[bytes, bytes], bytes], kind: bytes, bitcode: bytes, translated: Any, complaints: BinaryIO
) -> None:
    """Ends the process, with status 0 if there is a translation."""
    os.dup2(complaints.fileno(), 2)
    try:
        translated.write(translate(kind, bitcode))
        translated.flush()
        os._exit(0)
    except BaseException as error:
        os.write(2, str(error).encode())
        os._exit(1)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asks decides what an interruption means
    sys.path[:] = sys.argv[2:]
    serve(sys.argv[1])
