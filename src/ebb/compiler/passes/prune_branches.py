"""Drops what cannot run: branches of constant conditions, statements after a jump, loops that never turn."""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.kir_walk import map_bodies
from ebb.records import replace


def prune_branches(kernel: kir.Kernel) -> kir.Kernel:
    """``kernel`` without the statements that no row can reach."""
    return replace(kernel, body=_prune(kernel.body))


def _prune(body: kir.Body) -> kir.Body:
    kept: list[kir.Stmt] = []
    for stmt in body:
        match stmt:
            case kir.If(kir.Const(value), then, orelse):
                kept += _prune(then if value else orelse)
            case kir.While(kir.Const(value)) if not value:
                pass
            case _:
                kept.append(map_bodies(stmt, _prune))
        if kept and isinstance(kept[-1], kir.Break | kir.Continue | kir.Leave):
            break
    if len(kept) == len(body) and all(new is old for new, old in zip(kept, body, strict=True)):
        return body
    return tuple(kept)
