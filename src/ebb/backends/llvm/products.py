"""Inner products in loops over groups: a matrix times a vector, say, for each entry of a row of a sparse matrix.

Their numbers lie one behind the other in memory, three to a row of a block. LLVM makes pairs of them, with shuffles in
between; strips of turns would have to transpose whole blocks. Here each factor is loaded as one register, products are
added up lane by lane over all turns, and the lanes of each sum are added once, behind the loop. A product with a matrix
of 3 x 3 blocks takes two thirds of the time in the cache, and a tenth less where it waits for memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Protocol, TypeAlias

from ebb.backends.llvm import ops
from ebb.backends.llvm.fit import Unfit, change_of, demand
from ebb.backends.llvm.strips import split
from ebb.backends.llvm.writer import FunctionWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import values
from ebb.records import record
from ebb.types.types import Kind

_MOST_LANES = 8
"""Of a register. So it reaches less than 64 bytes beyond the last number, and as many lie behind each buffer."""

Definitions: TypeAlias = Mapping[int, lir.Operation]


@record
class Element:
    """A number that is loaded from a slot, ``offset`` elements behind ``root``; ``index`` is both."""

    slot: lir.Slot
    root: lir.Value
    offset: int
    index: lir.Value

    def follows(self, other: Element) -> bool:
        """Whether it lies right behind ``other``."""
        return (self.slot, self.root, self.offset - 1) == (other.slot, other.root, other.offset)


@record
class Product:
    """``place[index]`` grows by the sum of ``count`` products of what lies from ``left`` and from ``right`` on."""

    place: lir.Var
    index: lir.Literal
    left: Element
    right: Element
    count: int

    @property
    def lanes(self) -> int:
        """How many the register has."""
        return 1 << (self.count - 1).bit_length()


@record(eq=False)
class ProductPlan:
    """A loop that does nothing but add inner products to variables.

    Attributes:
        products: in order.
        inner: the temporaries that registers take the place of.
    """

    products: tuple[Product, ...]
    inner: frozenset[int]


def plan_products(loop: lir.For) -> ProductPlan | None:
    """The products that ``loop``, whose turns may run in any order, adds up, or None where it does something else."""
    try:
        return _plan(loop)
    except Unfit:
        return None


def _plan(loop: lir.For) -> ProductPlan:
    definitions: dict[int, lir.Operation] = {}
    stores: list[lir.StoreVar] = []
    for stmt in loop.body:
        match stmt:
            case lir.Let(temp, operation):
                definitions[temp.number] = operation
            case lir.StoreVar():
                stores.append(stmt)
            case _:
                raise Unfit
    demand(bool(stores))
    uses = Counter(value.number for stmt in loop.body for value in values(stmt) if isinstance(value, lir.Temp))
    inner: Counter[int] = Counter()
    products = tuple(_product(stmt, definitions, uses, inner) for stmt in stores)
    # What is loaded may be a factor of several products, but nothing else; no turn may look at a sum.
    demand(all(uses[number] == count for number, count in inner.items()))
    sums = {product.place for product in products}
    looks = (number for number, each in definitions.items() if isinstance(each, lir.LoadVar) and each.var in sums)
    demand(all(number in inner for number in looks))
    return ProductPlan(products, frozenset(inner))


def _product(store: lir.StoreVar, definitions: Definitions, uses: Mapping[int, int], inner: Counter[int]) -> Product:
    """What ``store`` adds; counts in ``inner`` how often it uses the temporaries that it comes from."""
    change = change_of(store.var, store.index, store.value, definitions, uses)
    if change is None or change.op != "+" or not isinstance(store.index, lir.Literal):
        raise Unfit
    demand(store.var.type.kind is Kind.FLOAT)
    inner.update(change.made)
    terms = [
        tuple(_element(factor, definitions, inner) for factor in term)
        for term in _terms(change.value, definitions, inner)
    ]
    first, _ = terms[0]
    terms = [(a, b) if (a.slot, a.root) == (first.slot, first.root) else (b, a) for a, b in terms]
    terms.sort(key=lambda term: term[0].offset)
    demand(1 < len(terms) <= _MOST_LANES)
    demand(all(b.follows(a) and d.follows(c) for (a, c), (b, d) in pairwise(terms)))
    return Product(store.var, store.index, *terms[0], len(terms))


def _terms(value: lir.Value, definitions: Definitions, inner: Counter[int]) -> Iterator[tuple[lir.Value, lir.Value]]:
    """The factors of each product of a sum."""
    if not isinstance(value, lir.Temp):
        raise Unfit
    inner[value.number] += 1
    match definitions.get(value.number):
        case lir.Binary("+", left, right):
            yield from _terms(left, definitions, inner)
            yield from _terms(right, definitions, inner)
        case lir.Binary("*", left, right):
            yield left, right
        case _:
            raise Unfit


def _element(value: lir.Value, definitions: Definitions, inner: Counter[int]) -> Element:
    if not isinstance(value, lir.Temp):
        raise Unfit
    inner[value.number] += 1
    match definitions.get(value.number):
        case lir.Load(lir.Slot(binding=lir.FieldData()) as slot, index):
            return Element(slot, *split(definitions, index), index)
        case _:
            raise Unfit


class Emitter(Protocol):
    """What emits the loop."""

    w: FunctionWriter
    temps: dict[int, str]
    flags: str
    sum_flags: str

    def value(self, value: lir.Value) -> str:
        """The name or literal of ``value``."""
        ...

    def statement(self, stmt: lir.Stmt) -> None:
        """Emits a statement."""
        ...

    def element(self, slot: lir.Slot, index: str) -> str:
        """The address of an element of a slot."""
        ...

    def group(self) -> str:
        """What says of an access that it is of a loop over independent rows."""
        ...

    def add_to(self, place: lir.Slot | lir.Var, index: str, op: str, value: str) -> None:
        """``place[index] = place[index] op value``."""
        ...


def emit_products(e: Emitter, loop: lir.For, plan: ProductPlan, metadata: str) -> None:
    """Appends ``loop``; the function goes on behind it."""
    w = e.w
    sums = [w.allocate(_register(product)) for product in plan.products]
    for place, product in zip(sums, plan.products, strict=True):
        w.do(f"store {_register(product)} zeroinitializer, ptr {place}")
    with w.loop(e.value(loop.start), e.value(loop.stop), metadata=metadata, type_=loop.counter.type) as turn:
        e.temps[loop.counter.number] = turn.counter
        for stmt in loop.body:
            if isinstance(stmt, lir.Let) and stmt.temp.number not in plan.inner:
                e.statement(stmt)
        loaded: dict[Element, str] = {}
        for place, product in zip(sums, plan.products, strict=True):
            t = _register(product)
            for factor in (product.left, product.right):
                if factor not in loaded:
                    address = e.element(factor.slot, e.value(factor.index))
                    loaded[factor] = w.emit(f"load {t}, ptr {address}, align {factor.slot.type.bits // 8}{e.group()}")
            more = w.emit(f"fmul{e.flags} {t} {loaded[product.left]}, {loaded[product.right]}")
            before = w.emit(f"load {t}, ptr {place}")
            w.do(f"store {t} {w.emit(f'fadd{e.sum_flags} {t} {before}, {more}')}, ptr {place}")
    for place, product in zip(sums, plan.products, strict=True):
        t = _register(product)
        lanes = w.emit(f"load {t}, ptr {place}")
        for k in range(product.count):
            e.add_to(product.place, str(product.index.value), "+", w.emit(f"extractelement {t} {lanes}, i32 {k}"))


def _register(product: Product) -> str:
    return f"<{product.lanes} x {ops.llvm_type(product.place.type)}>"
