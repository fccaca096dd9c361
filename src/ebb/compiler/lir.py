"""LIR, the low-level IR: how the rows of a kernel are computed, for every target. The whole grammar is this file.

Scalars only, in A-normal form: an operation takes values (temporaries and literals) and defines one temporary;
control flow is structured; memory is *slots*, distinct buffers that never overlap, indexed by element. A program is one
function over a *block* of rows, a fixed stretch that some thread (or workgroup) takes, and one that finishes the
launch. It holds no data: what stands behind a slot or an argument is a binding, looked up at each launch, so the text
of a program is the same for every launch and may key a cache.

Arithmetic is total: integer division by zero is 0, overflow wraps, shifts by too much give 0 (-1 for ``>>`` of a
negative number), floats to integers saturate. Keys are int64 positions; memory may hold them as int32.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from ebb.records import record
from ebb.types.types import ScalarType

if TYPE_CHECKING:
    from ebb.relations.field import Field
    from ebb.relations.globals import Global
    from ebb.relations.relation import Relation

BLOCK_ROWS = 1024
"""The rows of a block. Part of the meaning: partial results are per block, whatever the number of threads."""

# ---- Bindings: what the runtime puts behind a slot or an argument at each launch. ----


@record
class FieldData:
    field: Field


@record
class GroupOffsets:
    """Where each group of the grouping of ``index`` starts; one more entry than the target has rows."""

    index: Field


@record
class GroupRows:
    """The positions of the grouped rows, where the storage is not sorted by ``index``."""

    index: Field


@record
class RowOrder:
    """The identity of the row at each position of ``relation``."""

    relation: Relation


@record
class GlobalData:
    globl: Global


@record
class Partials:
    """What each block has summed in ``sum`` by the reduction number ``reduction``, one block after the other."""

    reduction: int
    sum: Var


@record
class LaunchPositions:
    """The positions of the rows to run on, where they are given as a list."""


@record
class PrintRecords:
    """Records of ``PRINT_HEADER + Program.print_words`` int64 words from ``PRINT_RECORDS`` on, behind how many prints
    there were (``PRINT_COUNTER``) and how many records there is room for (``PRINT_CAPACITY``)."""


SlotBinding: TypeAlias = (
    FieldData | GroupOffsets | GroupRows | RowOrder | GlobalData | Partials | LaunchPositions | PrintRecords
)


@record
class UniformComponent:
    uniform: int
    component: int


@record
class Extent:
    """``relation.shape[dimension]``."""

    relation: Relation
    dimension: int


@record
class ColumnStride:
    """How many elements after a column of a field of ``relation`` the next one begins, in the layout of columns, for
    elements of ``itemsize`` bytes.
    """

    relation: Relation
    itemsize: int


@record
class BlockCount:
    """How many blocks the launch has."""


class RandomWord(Enum):
    """A word of the key or the counter of the random numbers that is the same for a whole launch."""

    SEED_LOW = "seed low"
    SEED_HIGH = "seed high"
    LAUNCH = "launch"


ArgumentBinding: TypeAlias = UniformComponent | Extent | ColumnStride | BlockCount | RandomWord

# ---- Values and places. ----


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


@record
class Var:
    """A private array of ``size`` scalars, zero where it is declared."""

    number: int
    name: str
    type: ScalarType
    size: int


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


Operation: TypeAlias = Unary | Binary | Compare | Select | Convert | Math | Load | LoadVar | LoadArgument

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
    """``var`` comes into being and is zero."""

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
class RowLoop:
    """``body`` for each row of the block. On a CPU it is a loop, on a GPU the thread.

    ``index`` has one temporary, the number of the row in the launch, or on a box one a dimension, the coordinates.
    """

    index: tuple[Temp, ...]
    rows: Rows
    body: Body


@record
class Fail:
    """The launch has failed at ``Program.sites[site]`` in the row at ``position``; ``payload`` says how."""

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
    Let | Declare | StoreVar | Store | AtomicUpdate | Accumulate | If | For | While | Block | Leave | RowLoop | Fail
    | Print
)  # fmt: skip

# ---- Programs. ----


class Space(Enum):
    """How the rows of a launch are numbered.

    LINE: rows ``0 <= i < n``, which are positions or entries of a list of positions, in blocks of ``BLOCK_ROWS``.
    BOX: each block is a box of coordinates of a grid.
    """

    LINE = "line"
    BOX = "box"


class Precision(Enum):
    """What the optimiser may do to floats: fuse ``a*b+c``, or also reassociate."""

    CONTRACT = "contract"
    FAST = "fast"


class Updates(Enum):
    """How rows reduce into other rows: plainly, by a schedule that keeps them apart, or atomically."""

    PLAIN = "plain"
    ATOMIC = "atomic"


PAYLOAD_WORDS = 8
"""The most values that a ``Fail`` carries."""

PRINT_COUNTER, PRINT_CAPACITY, PRINT_RECORDS = range(3)
"""Where the words of ``PrintRecords`` lie."""

PRINT_HEADER = 2
"""The words of a print record before its values: the number of the print and the row's position."""


@record
class Program:
    """What runs at a launch: ``block`` for each block, then ``finish`` once.

    ``block_number`` is the number of the block, defined in ``block``. ``private_bytes`` is the size of all variables
    together. ``sites`` says what fails where, ``prints`` are KIR nodes; they are no part of the text.
    """

    name: str
    space: Space
    dimensions: int
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
