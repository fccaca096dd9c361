"""Which fields a kernel writes before it looks at them."""

from __future__ import annotations

import pytest
from elaborated import make_world

from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.residency import overwritten

WHOLE = {
    "v.f = 1": "f",
    "v.d = v.f": "d",
    "v.d = v.next.f\n    v.i = 2": "d i",
    "v.p = (1, 2, 3)": "p",
    "v.p[0] = 1\n    v.p[1] = 2\n    v.p[2] = v.f": "p",
    "v.p[0] = 1\n    v.p[2] = 2": "",
    "for i in range(3):\n        v.p[i] = i": "",
    "v.p[v.i] = 1": "",
    "v.f += 1": "",
    "v.f = v.f + 1": "",
    "x = v.f\n    v.f = x": "",
    "v.f = 1\n    x = v.f\n    v.d = x": "d f",
    "v.f = 0\n    for e in v.edges:\n        v.f += e.x": "f",
    "v.p[0] = 1\n    v.p += (1, 1, 1)\n    v.p = (1, 1, 1)": "",
    "if v.b:\n        v.f = 1\n    else:\n        v.f = 2\n        v.d = 1": "f",
    "if v.b:\n        v.f = 1": "",
    "if v.b:\n        return\n    v.f = 1": "",
    "if v.b:\n        v.f = 1\n        return\n    v.f = 2": "f",
    "v.f = 1\n    if v.b:\n        return\n    v.d = 1": "f",
    "for e in v.edges:\n        v.f = e.x": "",
    "while v.b:\n        v.f = 1\n        break": "",
    "for i in range(v.i):\n        if v.b:\n            continue\n        v.f = 1\n    v.f = 2": "f",
    "for i in range(v.i):\n        v.d = v.f\n    v.f = 2": "",
    "v.next.f += 1": "",
    "v.double = 4": "d",
    "v.double += 4": "",
    "reset(v)": "f",
    "v.d = bump(v)": "d",
    "v.d = positive(v.d)": "",
    "v.d = positive(v.f)": "d",
    "v.next = v": "next",
    "G.value += v.f\n    v.b = False": "b",
    "assert v.f > 0\n    v.d = 1": "d",
}


@pytest.mark.parametrize("body", WHOLE, ids=lambda body: body.replace("\n", ";").replace("    ", " "))
def test_fields_are_overwritten_where_every_way_writes_them_first(body: str) -> None:
    kernel = make_world().elaborate(body.replace("\n    ", "\n")).kernel
    found = overwritten(kernel, check_phases(kernel))
    assert sorted(field.name for field in found) == WHOLE[body].split()
