"""LIR, the low-level IR: how the rows of a kernel are computed, for every target.

The whole grammar is this file, but for what stands behind slots and arguments: that is ``lir_bindings``.

Scalars only, in A-normal form: an operation takes values (temporaries and literals) and defines one temporary;
control flow is structured; memory is *slots*, distinct buffers that never overlap, indexed by element. A program is one
function over a *block* of rows, a fixed stretch that a thread takes or rows that a group of threads share, and one that
finishes the launch. It holds no data: what stands behind a slot or an argument is a binding, looked up at each launch,
so the text of a program is the same for every launch and may key a cache.

Arithmetic is total: integer division by zero is 0, overflow wraps, shifts by too much give 0 (-1 for ``>>`` of a
negative number), floats to integers saturate. Keys are int64 positions; memory may hold them as int32.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any, TypeAlias

from ebb.compiler.lir_bindings import (
    BlockCount,
    ColumnStride,
    Extent,
    FieldData,
    GlobalData,
    GroupOffsets,
    GroupRows,
    LaunchPositions,
    Partials,
    PrintRecords,
    RandomWord,
    RowOrder,
    UniformComponent,
)
from ebb.records import record
from ebb.types.types import ScalarType

BLOCK_ROWS = 1024
"""The rows of a block that one thread takes. Part of the meaning: partial results are per block, whatever the number of
threads."""

MOST_THREADS = 1024
"""The most threads that a group may have."""

MOST_GROUPS = 1024
"""The most groups of a launch whose threads take several rows each, and so the most partial results."""

# ---- Values and places. ----

SlotBinding: TypeAlias = (
    FieldData | GroupOffsets | GroupRows | RowOrder | GlobalData | Partials | LaunchPositions | PrintRecords
)

ArgumentBinding: TypeAlias = UniformComponent | Extent | ColumnStride | BlockCount | RandomWord


class Access(Enum):
    """What a program does with a slot."""

    READ = "read"
    WRITE = "write"


@record
class Slot:
    """A buffer of ``type``. No two slots of a program overlap."""

    number: int
    type: ScalarType
    access: Access
    binding: SlotBinding


@record
class Argument:
    """A scalar that is the same for all rows of a launch."""

    number: int
    type: ScalarType
    binding: ArgumentBinding


@record
class Temp:
    """The result of one operation; defined once."""

    number: int
    type: ScalarType


@record
class Literal:
    value: Any
    type: ScalarType


Value: TypeAlias = Temp | Literal


class Memory(Enum):
    """Whose a variable is: of each thread its own, zero where it is declared, or of a group, undefined at first."""

    PRIVATE = "private"
    GROUP = "group"


@record
class Var:
    """An array of ``size`` scalars."""

    number: int
    name: str
    type: ScalarType
    size: int
    memory: Memory


@record
class Label:
    number: int
    name: str


# ---- Operations: pure but for what they read. ----


@record
class Unary:
    """``-`` of a number, ``~`` of an integer, ``not`` of a bool."""

    op: str
    operand: Value


@record
class Binary:
    """``+ - * / // % & | ^ << >> min max`` of two values of one type; on bools ``& | ^``."""

    op: str
    left: Value
    right: Value


@record
class Compare:
    """``== != < <= > >=`` of two values of one type, a bool."""

    op: str
    left: Value
    right: Value


@record
class Select:
    """``then`` or ``other``; both are values already."""

    condition: Value
    then: Value
    other: Value


@record
class Convert:
    """``operand`` as the type of the temporary that is defined."""

    operand: Value


@record
class Math:
    """A function of ``MATH`` of values of one type, which is that of the result."""

    function: str
    operands: tuple[Value, ...]


@record
class Load:
    slot: Slot
    index: Value


@record
class LoadVar:
    var: Var
    index: Value


@record
class LoadArgument:
    argument: Argument


@record
class ThreadNumber:
    """The number of the thread in its group, an int64."""


Operation: TypeAlias = (
    Unary | Binary | Compare | Select | Convert | Math | Load | LoadVar | LoadArgument | ThreadNumber
)  # fmt: skip

_UNARY_FUNCTIONS = (
    "abs", "sqrt", "cbrt", "exp", "log", "log2", "log10", "exp2", "expm1", "log1p", "sin", "cos", "tan", "asin",
    "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "floor", "ceil", "trunc", "round",
    "erf", "erfc", "gamma", "lgamma",
)  # fmt: skip
_BINARY_FUNCTIONS = ("pow", "atan2", "fmod", "copysign", "hypot", "ipow")

MATH: Mapping[str, int] = {
    name: operands for operands, names in ((1, _UNARY_FUNCTIONS), (2, _BINARY_FUNCTIONS)) for name in names
}
"""The mathematical functions and how many operands each takes; all on floats but ``ipow``, an integer power."""

# ---- Statements. ----

Body: TypeAlias = "tuple[Stmt, ...]"


@record
class Let:
    temp: Temp
    operation: Operation


@record
class Declare:
    """``var`` comes into being."""

    var: Var


@record
class StoreVar:
    var: Var
    index: Value
    value: Value


@record
class Store:
    slot: Slot
    index: Value
    value: Value


@record
class AtomicUpdate:
    """``slot[index] = slot[index] op value`` at once, whatever other rows do meanwhile."""

    slot: Slot
    index: Value
    op: str
    value: Value


@record
class Accumulate:
    """``var[index] = var[index] op value``, in any order and grouping of the values that a block accumulates."""

    var: Var
    index: Value
    op: str
    value: Value


@record
class If:
    condition: Value
    then: Body
    orelse: Body


class Turns(Enum):
    """Whether the turns of a loop have an order: where they have none, sums over them may be taken in any grouping."""

    IN_ORDER = "in order"
    ANY_ORDER = "in any order"


@record
class For:
    """``for counter in range(start, stop)``. ``turns`` says whether their order means anything."""

    counter: Temp
    start: Value
    stop: Value
    body: Body
    turns: Turns


@record
class While:
    """Runs ``head``, leaves if ``condition``, which it computed, is false, runs ``body``, and so on."""

    head: Body
    condition: Value
    body: Body


@record
class Block:
    """``body``, which ``Leave`` of ``label`` ends."""

    label: Label
    body: Body


@record
class Leave:
    label: Label


class Rows(Enum):
    """Whether the rows of a loop touch one another's memory."""

    INDEPENDENT = "independent"
    IN_ORDER = "in order"


@record
class Inside:
    """What rows run that are not near the ends of a line of the grid, where coordinates wrap or are held.

    ``ends``: how many are near at its beginning and at its end; ``length``: that of a line."""

    ends: tuple[int, int]
    length: Argument
    body: Body


@record
class RowPlace:
    """The ``size`` elements of a slot that are those of the row at the position ``row``."""

    slot: Slot
    row: Value
    size: int


@record
class Streaming:
    """Rows that go through more memory than caches hold. Values are those of ``Inside.body`` where there is one.

    Attributes:
        written: of the row itself, all of it and never read: it need not come into the cache.
        ahead: of the row of another line that is read last of all of its place in the order: worth fetching before.
    """

    written: tuple[RowPlace, ...]
    ahead: tuple[RowPlace, ...]


@record
class RowLoop:
    """``body`` for each row of the block, or on groups for each of the thread's rows, as ``Program.coverage`` says.

    ``index`` has one temporary, the number of the row in the launch, or on a box one a dimension, the coordinates.
    Only rows that are independent have ``streaming``, only those of boxes ``inside``.
    """

    index: tuple[Temp, ...]
    rows: Rows
    body: Body
    inside: Inside | None = None
    streaming: Streaming | None = None


@record
class Barrier:
    """All threads of the group get here before any goes on, and see what the others have stored in its variables."""


@record
class Fail:
    """The launch has failed at ``Program.sites[site]`` in the row at ``position``; ``payload`` says how.

    The row ends here. So does the block of a thread; the threads of a group go on, since others wait at barriers.
    """

    site: int
    position: Value
    payload: tuple[Value, ...]


@record
class Print:
    """A record for ``Program.prints[number]``: the row's position and the values, in their own types."""

    number: int
    slot: Slot
    position: Value
    values: tuple[Value, ...]


Stmt: TypeAlias = (
    Let | Declare | StoreVar | Store | AtomicUpdate | Accumulate | If | For | While | Block | Leave | RowLoop | Barrier
    | Fail | Print
)  # fmt: skip

# ---- Programs. ----


class Space(Enum):
    """How the rows of a launch are numbered.

    LINE: rows ``0 <= i < n``, which are positions or entries of a list of positions, in blocks of ``BLOCK_ROWS``.
    BOX: each block is a box of coordinates of a grid; on groups the whole launch is one, its rows numbered row-major.
    """

    LINE = "line"
    BOX = "box"


class Coverage(Enum):
    """Which rows a thread of a group takes: the thread t of the group g begins with the row g * group_size + t.

    ONE: that row, if there is such.
    STRIDED: that row and every (groups * group_size)-th after it, in this order.
    """

    ONE = "one row a thread"
    STRIDED = "strided rows"


class Precision(Enum):
    """What the optimiser may do to floats: fuse ``a*b+c``, or also reassociate."""

    CONTRACT = "contract"
    FAST = "fast"


class Updates(Enum):
    """How rows reduce into other rows: plainly, by a schedule that keeps them apart, or atomically."""

    PLAIN = "plain"
    ATOMIC = "atomic"


class Stores(Enum):
    """Whether what a launch writes may still be in the cache when it is read, or is more than fits in there."""

    KEPT = "kept"
    STREAMED = "streamed"


PAYLOAD_WORDS = 8
"""The most values that a ``Fail`` carries."""

PRINT_COUNTER, PRINT_CAPACITY, PRINT_RECORDS = range(3)
"""Where the words of ``PrintRecords`` lie."""

PRINT_HEADER = 2
"""The words of a print record before its values: the number of the print and the row's position."""


@record
class Program:
    """What runs at a launch: ``block`` for each block, then ``finish`` once.

    Without a ``group_size`` a thread runs ``block`` for all rows of it, and ``finish``. With it a block is a group of
    so many threads, each of which runs ``block`` for its rows; one more group runs ``finish``. Where rows run in order,
    ``group_size`` is 1, and a launch has one group.

    ``block_number`` is the number of the block, defined in ``block``. ``private_bytes`` is the size of all private
    variables together. ``sites`` says what fails where, ``prints`` are KIR nodes; they are no part of the text.
    """

    name: str
    space: Space
    dimensions: int
    group_size: int | None
    coverage: Coverage
    precision: Precision
    slots: tuple[Slot, ...]
    arguments: tuple[Argument, ...]
    block_number: Temp
    block: Body
    finish: Body
    private_bytes: int
    sites: tuple[Any, ...]
    prints: tuple[Any, ...]
    print_words: int

    @property
    def in_order(self) -> bool:
        """Whether the rows run one after the other."""
        return any(isinstance(stmt, RowLoop) and stmt.rows is Rows.IN_ORDER for stmt in self.block)

    @property
    def streams(self) -> Streaming | None:
        """How its rows go through more memory than caches hold."""
        return next((stmt.streaming for stmt in self.block if isinstance(stmt, RowLoop)), None)

    @property
    def entries(self) -> tuple[str, ...]:
        """The names of the kernels for groups: of ``block``, and of ``finish`` if there is anything to finish."""
        name = "ebb_" + "".join(c if c.isascii() and c.isalnum() else "_" for c in self.name)
        return (name, f"{name}_finish") if self.finish else (name,)
