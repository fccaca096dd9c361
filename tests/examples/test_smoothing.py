"""Smoothing: noise goes, shapes and boundaries stay."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import smoothing
from ebb.domains import PolyMesh


def run(mesh, steps, method="taubin", noise=0.3):
    smoothing.prepare(mesh, noise, 2)
    before = smoothing.measure(mesh)
    for _ in range(steps):
        smoothing.step(mesh, method)
    return before, smoothing.measure(mesh)


def test_noise_goes_and_the_boundary_stays():
    mesh = smoothing.landscape(16)
    start = mesh.vertices.pos.to_numpy()
    clean = smoothing.landscape(16)
    smoothing.prepare(clean, 0.0, 1)
    before, after = run(mesh, 30)
    assert after.figures["bend"] < 0.2 * before.figures["bend"]
    assert after.figures["sharpest"] < before.figures["sharpest"]
    assert after.volume == pytest.approx(smoothing.measure(clean).volume, rel=0.02)
    moved = np.abs(mesh.vertices.pos.to_numpy() - start).max(axis=1) > 0
    on_edge = np.abs(start[:, :2]).max(axis=1) > 0.4999
    assert not moved[on_edge].any() and moved[~on_edge].all()


def test_taubin_keeps_what_laplace_shrinks():
    volumes = {}
    for method in ("taubin", "laplace"):
        before, after = run(PolyMesh.globe(24, 12), 40, method)
        volumes[method] = after.volume / before.volume
    assert volumes["taubin"] == pytest.approx(1, abs=0.03)
    assert volumes["laplace"] < 0.9


def test_a_step_is_the_mean_of_the_centres_around():
    mesh = PolyMesh.grid(4, 3, split="checkered")
    mesh.vertices.pos.load(mesh.vertices.pos.to_numpy() + np.random.default_rng(1).normal(0, 0.02, (20, 3)))
    smoothing.prepare(mesh, 0.0, 1)
    points = mesh.vertices.pos.to_numpy().astype(float)
    corners, offsets = smoothing.faces_of(mesh)
    total, weight = np.zeros_like(points), np.zeros(len(points))
    for start, stop in pairwise(offsets):
        p = points[corners[start:stop]]
        middle = p.mean(axis=0)
        area = np.linalg.norm(np.cross(p - middle, np.roll(p, -1, axis=0) - middle).sum(axis=0)) / 2
        total[corners[start:stop]] += area * middle
        weight[corners[start:stop]] += area
    inner = np.zeros(len(points), dtype=bool)
    inner.reshape(5, 4)[1:-1, 1:-1] = True
    expected = points + smoothing.FORWARD * inner[:, None] * (total / weight[:, None] - points)
    smoothing.step(mesh, "laplace")
    assert mesh.vertices.pos.to_numpy() == pytest.approx(expected, abs=1e-6)


def test_cells_of_a_solid_grow_round_and_unfold():
    before, after = run(smoothing.foam(4), 12)
    assert before.figures["folded"] > 0 and after.figures["folded"] == 0
    assert after.figures["least"] > before.figures["least"] > 0
    assert after.figures["roundness"] > 1.2 * before.figures["roundness"]
    assert before.volume == pytest.approx(1, rel=1e-5)
    assert after.volume == pytest.approx(1, rel=1e-5)


def test_known_qualities():
    box = PolyMesh.box(2, 2, 2)
    smoothing.prepare(box, 0.0, 1)
    quality = smoothing.measure(box)
    assert quality.figures == {"roundness": pytest.approx(np.pi / 6), "least": pytest.approx(np.pi / 6), "folded": 0}
    roof = PolyMesh.from_arrays(
        [[0, 0, 0], [1, 0, 1], [2, 0, 0], [0, 1, 0], [1, 1, 1], [2, 1, 0]], [[0, 1, 4, 3], [1, 2, 5, 4]]
    )
    smoothing.prepare(roof, 0.0, 1)
    quality = smoothing.measure(roof)
    assert quality.figures == {"bend": pytest.approx(90, abs=1e-3), "sharpest": pytest.approx(90, abs=1e-3)}
    assert quality.volume == pytest.approx(1)


def test_the_program(tmp_path):
    app = typer.Typer()
    app.command()(smoothing.main)

    def invoke(*words):
        return CliRunner().invoke(app, [str(word) for word in words])

    PolyMesh.goldberg(1).save(tmp_path / "ball.off")
    saved = tmp_path / "deep" / "smooth.off"
    result = invoke("--mesh", tmp_path / "ball.off", "--steps", 3, "--noise", 0.1, "--save", saved)
    assert result.exit_code == 0, result.output
    assert "42 faces>, 3 steps" in result.output and "bend" in result.output
    assert PolyMesh.load(saved).faces.size == 42
    result = invoke("--size", 2, "--steps", 2)
    assert result.exit_code == 0 and "roundness" in result.output
    for words, text in {
        ("--method", "fair"): "--method should be",
        ("--save", tmp_path / "both.vtu"): "two meshes do not go into one file",
        ("--mesh", "solid", "--save", tmp_path / "solid.off"): "solid.off should end in .png or .vtu",
    }.items():
        result = invoke(*words)
        assert result.exit_code == 2, result.output
        assert text in " ".join(result.output.replace("│", " ").split()), result.output
    result = invoke("--mesh", tmp_path / "none.off")
    assert result.exit_code == 1
