"""The text of an LLVM module under construction: functions, declarations and metadata."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager

from ebb.backends.llvm.hooks import Hooks
from ebb.records import record
from ebb.types.types import Kind, ScalarType, int64

VECTORS = "!ebb.vectors"
"""The metadata of a module whose rows are vectors already, so that LLVM need not look for more of them in rows."""

SERIAL = "!ebb.serial"
"""The metadata of a module whose rows run one by one and have no loops: LLVM need not look for what gains by loops."""


class ModuleWriter:
    """Collects the functions of a module and what they refer to."""

    def __init__(self, hooks: Hooks) -> None:
        self.hooks = hooks
        self.functions: list[str] = []
        self.declarations: dict[str, None] = {}
        self.definitions: dict[str, str] = {}
        self.metadata: list[str] = []
        self.kept: dict[str, None] = {}
        self.is_vectors = False
        self.is_serial = False

    def note(self, text: str) -> str:
        """Appends a metadata node and returns its name; ``{self}`` in ``text`` stands for the name."""
        name = f"!{len(self.metadata)}"
        self.metadata.append(f"{name} = {text.format(self=name)}")
        return name

    def text(self) -> str:
        """The module as LLVM assembly."""
        declared = [f"declare {signature}" for signature in self.declarations]
        if self.kept:
            names = ", ".join(f"ptr @{name}" for name in self.kept)
            declared.append(
                f'@llvm.compiler.used = appending global [{len(self.kept)} x ptr] [{names}], section "llvm.metadata"'
            )
        parts = [*declared, *self.definitions.values(), *self.functions, *self.metadata]
        parts += [f"{name} = !{{}}" for name, holds in ((VECTORS, self.is_vectors), (SERIAL, self.is_serial)) if holds]
        return "\n".join(parts) + "\n"


@record
class Carried:
    """A value that turns of a loop hand on.

    Attributes:
        type: LLVM's.
        first: what the first turn gets.
        last: the name under which a turn leaves what the next one gets.
    """

    type: str
    first: str
    last: str


@record(frozen=False, eq=False)
class Turn:
    """A turn of a loop: its counter, by how much that grows at the end, and what has been carried to the turn."""

    counter: str
    step: str
    carried: Sequence[str]


class FunctionWriter:
    """Instructions of one function, appended block by block."""

    def __init__(self, module: ModuleWriter) -> None:
        self.module = module
        self.hooks = module.hooks
        self.label = "entry"
        self._lines: list[str] = []
        self._allocas: list[str] = []
        self._count = 0
        self._known: dict[str, str] | None = None

    def fresh(self, stem: str) -> str:
        """A name that no instruction or label of the function has."""
        self._count += 1
        return f"{stem}.{self._count}"

    def emit(self, instruction: str) -> str:
        """Appends ``instruction`` and returns the name of its result."""
        if self._known is not None and instruction in self._known:
            return self._known[instruction]
        name = f"%{self.fresh('v')}"
        self._lines.append(f"  {name} = {instruction}")
        if self._known is not None and not instruction.startswith(("load", "phi")):
            self._known[instruction] = name
        return name

    def remember(self) -> None:
        """From here on what is computed a second time is taken from the first: each block follows the one before."""
        self._known = {}

    def forget(self) -> None:
        """Ends ``remember``."""
        self._known = None

    @contextmanager
    def apart(self) -> Generator[None, None, None]:
        """What is computed within the ``with`` statement is not to be had behind it: not every way leads through it."""
        known = None if self._known is None else dict(self._known)
        yield
        self._known = known

    def do(self, instruction: str) -> None:
        """Appends an instruction without result."""
        self._lines.append(f"  {instruction}")

    def allocate(self, type_: str) -> str:
        """Memory of the function, allotted at its entry."""
        name = f"%{self.fresh('var')}"
        self._allocas.append(f"  {name} = alloca {type_}")
        return name

    def declare(self, signature: str) -> None:
        """Makes the module declare an external function."""
        self.module.declarations[signature] = None

    def keep(self, signature: str, name: str) -> None:
        """Makes the module declare an external function that LLVM may come to call."""
        self.declare(signature)
        self.module.kept[name] = None

    def define(self, name: str, text: str) -> None:
        """Makes the module define a function of its own."""
        self.module.definitions[name] = text

    def branch(self, label: str) -> None:
        """Ends the basic block with a jump to ``label``."""
        self.do(f"br label %{label}")

    def branch_if(self, condition: str, then: str, other: str) -> None:
        """Ends the basic block with a jump to ``then`` or ``other``."""
        self.do(f"br i1 {condition}, label %{then}, label %{other}")

    def start(self, label: str) -> None:
        """Begins the basic block ``label``."""
        self._lines.append(f"{label}:")
        self.label = label

    @contextmanager
    def loop(
        self, start: str, stop: str, step: int | str = 1, metadata: str = "", type_: ScalarType = int64,
        carried: Sequence[Carried] = (), label: str = "turn",
    ) -> Generator[Turn, None, None]:  # fmt: skip
        """A loop, whose body is what the ``with`` statement appends.

        Args:
            start: what its counter begins with.
            stop: what the counter is below in each turn; ``step`` more does not overflow.
            step: by how much it grows, unless the turn says otherwise.
            metadata: of the branch that closes the loop.
            type_: that of the counter, an integer.
            carried: what turns hand on.
            label: of its body, but for a number.
        """
        head, turn, latch, done = (self.fresh(stem) for stem in ("head", label, "latch", "done"))
        before, following, t = self.label, f"%{self.fresh('next')}", f"i{type_.bits}"
        test, wraps = ("slt", "nsw") if type_.kind is Kind.SIGNED else ("ult", "nuw")
        self.branch(head)
        self.start(head)
        counter = self.emit(f"phi {t} [ {start}, %{before} ], [ {following}, %{latch} ]")
        values = [self.emit(f"phi {of.type} [ {of.first}, %{before} ], [ {of.last}, %{latch} ]") for of in carried]
        self.branch_if(self.emit(f"icmp {test} {t} {counter}, {stop}"), turn, done)
        self.start(turn)
        here = Turn(counter, str(step), values)
        yield here
        self.branch(latch)
        self.start(latch)
        self.do(f"{following} = add {wraps} {t} {counter}, {here.step}")
        self.do(f"br label %{head}{metadata}")
        self.start(done)

    def finish(self, header: str) -> None:
        """Adds the function to the module. Its last basic block has been ended."""
        body = "\n".join([*self._allocas, *self._lines])
        self.module.functions.append(f"{header} {{\nentry:\n{body}\n}}\n")
