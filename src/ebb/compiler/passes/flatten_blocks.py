"""Splices the blocks of inlined functions that end where they are left into the code around them."""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.kir_walk import map_bodies, statements
from ebb.records import replace


def flatten_blocks(kernel: kir.Kernel) -> kir.Kernel:
    """``kernel`` without the blocks that are left at their end only: functions whose one ``return`` comes last."""
    return replace(kernel, body=_flatten(kernel.body))


def _flatten(body: kir.Body) -> kir.Body:
    flat: list[kir.Stmt] = []
    for stmt in body:
        inner = map_bodies(stmt, _flatten)
        if isinstance(inner, kir.Block):
            rest = _without_last_leave(inner)
            if not any(isinstance(left, kir.Leave) and left.label == inner.label for left in statements(rest)):
                flat += rest
                continue
        flat.append(inner)
    if len(flat) == len(body) and all(new is old for new, old in zip(flat, body, strict=True)):
        return body
    return tuple(flat)


def _without_last_leave(block: kir.Block) -> kir.Body:
    body = block.body
    if body and isinstance(body[-1], kir.Leave) and body[-1].label == block.label:
        return body[:-1]
    return body
