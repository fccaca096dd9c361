"""The examples on every backend, and while the backend changes: before every step, and before every launch."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest

import ebb
import heat
import rendermesh
import spring_mass
from backends import lacking, runnable
from bodies import Body
from ebb.domains import TetMesh, TriMesh

Example = tuple[Callable[[int], object], tuple[ebb.Relation, ...]]
"""What advances an example and gives the numbers that it prints, and the relations that it keeps its state in."""

STEPS = 9
TURNS = ("cpu", "opencl", "reference", "opencl", "cpu", "reference")
"""Each backend is followed by each of the others."""


def falling_body() -> Example:
    skin = TriMesh.icosphere(1, 0.5)
    body = Body("ball", TetMesh.from_surface(skin, resolution=3), skin)
    spring_mass.prepare(body, 0.01)
    body.solid.vertices.qd.load([0.3, 0.0, -1.0])
    dt = spring_mass.stable_step(body.solid)

    def step(number: int) -> object:
        spring_mass.step(body.solid, dt)
        spring_mass.surface(body)
        energy = spring_mass.measure(body.solid)
        return energy.kinetic, energy.elastic, energy.height

    return step, (body.solid.vertices, body.solid.edges, body.solid.tetrahedra, body.skin.vertices)


def heated_torus() -> Example:
    mesh = TriMesh.torus(1, 0.4, 8, 5)
    heat.prepare(mesh, np.random.default_rng(2).random(mesh.vertices.size))
    dt = heat.stable_step(mesh, 1.0)
    return lambda number: (heat.step(mesh, dt, 1.0), *heat.totals(mesh)), (mesh.vertices, mesh.edges, mesh.triangles)


def twisted_torus() -> Example:
    skin = TriMesh.torus(1.0, 0.4, 8, 5)
    solid = TetMesh.from_surface(skin, resolution=4)
    rendermesh.couple(skin, solid)

    def step(number: int) -> object:
        rendermesh.deform(skin, solid, 0.05 * number)
        return rendermesh.distance(skin)

    return step, (skin.vertices, solid.vertices)


@contextmanager
def changing(backends: Sequence[str], each: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """Gives what to call before every step, so that ``backends`` take turns, step by step or launch by launch."""
    turns = itertools.cycle(backends)
    with ebb.backend(next(turns)), monkeypatch.context() as patch:
        if each == "step":
            yield lambda: ebb.set_backend(next(turns))
            return
        launch = ebb.Kernel.__call__

        def turn_and_launch(*arguments: object, **named: object) -> None:
            ebb.set_backend(next(turns))
            launch(*arguments, **named)

        patch.setattr(ebb.Kernel, "__call__", turn_and_launch)
        yield lambda: None


def run(make: Callable[[], Example], backends: Sequence[str], each: str, monkeypatch: pytest.MonkeyPatch) -> list:
    """What the example printed, then all that its relations hold."""
    with changing(backends, each, monkeypatch) as before_step:
        step, relations = make()
        printed = []
        for number in range(STEPS):
            before_step()
            printed.append(step(number))
    return [np.array(printed), *(field.to_numpy() for relation in relations for field in relation.fields.values())]


EXAMPLES = {"spring_mass": (falling_body, 1e-4), "heat": (heated_torus, 1e-11), "rendermesh": (twisted_torus, 1e-5)}


@pytest.mark.parametrize(
    ("backends", "each"),
    [(("reference",), "step"), (("opencl",), "step"), (TURNS, "step"), (TURNS, "launch")],
    ids=["reference", "opencl", "a turn a step", "a turn a launch"],
)
@pytest.mark.parametrize("example", EXAMPLES)
def test_every_backend_gives_what_cpu_gives(example, backends, each, monkeypatch) -> None:
    if not runnable(*backends):
        pytest.skip(lacking(*backends))
    make, tolerance = EXAMPLES[example]
    expected = run(make, ("cpu",), "step", monkeypatch)
    for found, value in zip(run(make, runnable(*backends), each, monkeypatch), expected, strict=True):
        if value.dtype.kind == "f":
            np.testing.assert_allclose(found, value, rtol=tolerance, atol=tolerance * max(1, np.abs(value).max()))
        else:
            np.testing.assert_array_equal(found, value)
