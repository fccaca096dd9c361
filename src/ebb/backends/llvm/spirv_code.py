"""SPIR-V of LLVM modules, by the process of ``spirv_translator``, which is started when it is first needed."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading
from typing import Any

from ebb.backends.llvm import spirv_translator
from ebb.backends.llvm.spirv import EXTENSIONS, TRIPLE
from ebb.backends.llvm.spirv_translator import ANSWER, BINARY, FORKS, REQUEST, TEXT
from ebb.compiler.kir_verify import CompilerBug
from ebb.errors import BackendError
from ebb.runtime.errors import NoMachineCode


class Untranslated(CompilerBug):
    """LLVM does not translate the module: a fault of the compiler, never of the user."""


class _Translator:
    """A process that translates, and what is asked of it, one thread after the other."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._parents: subprocess.Popen[bytes] | None = None

    def translated(self, kind: bytes, module: Any) -> bytes:
        """What becomes of ``module``.

        Raises:
            Untranslated: nothing.
        """
        bitcode: bytes = module.as_bitcode()
        with self._lock:
            done, answer = self._ask(REQUEST.pack(kind, len(bitcode)) + bitcode)
        if not done:
            raise Untranslated(f"{answer.decode(errors='replace').strip() or 'the translator ended'}\n{module}")
        return answer

    def end(self) -> None:
        """Ends the process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()  # not by the end of its input, which processes that were forked from this one hold open too
            process.communicate()

    def _ask(self, request: bytes) -> tuple[bool, bytes]:
        process = self._running()
        assert process.stdin is not None and process.stdout is not None
        whole = False
        try:
            process.stdin.write(request)
            process.stdin.flush()
            header = process.stdout.read(ANSWER.size)
            if len(header) < ANSWER.size:
                return False, b""
            done, size = ANSWER.unpack(header)
            answer = process.stdout.read(size)
            whole = len(answer) == size
            return done and whole, answer
        except BrokenPipeError:  # it has ended
            return False, b""
        finally:
            # Interrupted, or it ended: the next request must not get this one's answer. Or it is about to end.
            if not whole or not FORKS:
                self.end()

    def _running(self) -> subprocess.Popen[bytes]:
        """The process; another one where it has ended."""
        if self._process is None or self._process.poll() is not None:
            extensions = ",".join(f"+{name}" for name in EXTENSIONS)
            if not sys.executable or getattr(sys, "frozen", False):  # started again, the program would start itself
                raise BackendError(NoMachineCode(TRIPLE, "this program has no Python of its own that could be started"))
            command = [sys.executable, "-I", "-S", spirv_translator.__file__, extensions, *filter(None, sys.path)]
            try:
                self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            except OSError as error:
                raise BackendError(NoMachineCode(TRIPLE, f"{sys.executable}: {error}")) from error
        return self._process

    def after_fork(self) -> None:
        """In a process that was forked, maybe while another thread was asking: the process is that of the parent."""
        self._lock = threading.Lock()
        self._parents, self._process = self._process, None  # kept, since to let go of it would flush what it is sent


_translator = _Translator()
atexit.register(_translator.end)
if FORKS:
    os.register_at_fork(after_in_child=_translator.after_fork)


def spirv_binary(module: Any) -> bytes:
    """``module`` as SPIR-V.

    Raises:
        Untranslated: LLVM does not translate it.
        BackendError: there is no Python that could be started for it.
    """
    return _translator.translated(BINARY, module)


def spirv_text(module: Any) -> str:
    """``module`` as the assembly text of SPIR-V; it raises what ``spirv_binary`` does."""
    return _translator.translated(TEXT, module).decode()
