"""The programs with finite elements, as a user runs them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

import ebb
import fem
import fem_corotational
import fem_neohookean
import fem_program
import fem_stvk
from ebb.domains import TetMesh, TriMesh

PROGRAMS = {"stvk": fem_stvk, "neohookean": fem_neohookean, "corotational": fem_corotational}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs a program in a folder of its own, and gives its exit code and all that it says."""
    monkeypatch.chdir(tmp_path)

    def invoke(*words: object, law: str = "stvk") -> tuple[int, str]:
        app = typer.Typer()
        app.command()(PROGRAMS[law].main)
        with ebb.backend("cpu"):
            result = CliRunner().invoke(app, [str(word) for word in words])
        said = str(result.exception.code) if isinstance(result.exception, SystemExit) else ""
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result.exit_code, result.output + said

    return invoke


def write_veg(path: Path, material: str = "ENU, 500, 30000, 0.25") -> TetMesh:
    mesh = TetMesh.box(2, 1, 1, (2.0, 1.0, 1.0))
    mesh.save(path)
    with path.open("a") as file:
        file.write(f"\n*MATERIAL soft\n{material}\n\n*REGION\nallElements, soft\n")
    return mesh


@pytest.mark.parametrize("law", PROGRAMS)
def test_the_default_run(run, law, tmp_path):
    code, text = run("--steps", 3, "--resolution", 6, "--dump", "bar.npz", law=law)
    assert code == 0 and "144 tetrahedra, 63 vertices, 9 of them fixed, 3 steps" in text.replace("\n", " ")
    with np.load(tmp_path / "bar.npz") as states:
        assert states["q"].shape == states["v"].shape == (3, 63, 3)
        assert states["iterations"].shape == states["assembly_s"].shape == states["solve_s"].shape == (3,)
        assert (states["q"][:, :, 1].min(axis=1) < 0).all()
        assert states["q"][2] == pytest.approx(states["q"][1] + 0.01 * states["v"][2], abs=1e-15)
        numbers = [line.split() for line in text.splitlines() if line.strip()[:1].isdigit()][:3]
        assert [int(words[1]) for words in numbers] == states["iterations"].tolist()


def test_moments_reach_to_the_last_step():
    assert fem_program.spread(100, 4) == {0, 25, 50, 75, 100}
    assert fem_program.spread(3, 4) == fem_program.spread(3, 50) == {0, 1, 2, 3}


def test_pictures_series_and_last_states(run, tmp_path, monkeypatch):
    pytest.importorskip("meshio")
    drawn = []
    monkeypatch.setattr(fem_program, "save_strip", lambda path, moments: drawn.extend(moments) or path.write_text(""))
    files = ("out/bar.png", "out/bar.pvd", "bar.vtu", "bar.veg")
    words = [word for name in files for word in ("--save", name)]
    code, text = run("--steps", 4, "--resolution", 4, "--frames", 2, *words)
    assert code == 0 and all(f"saved {name}" in text for name in files)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "bar.png", "bar.pvd", "bar_000000.vtu", "bar_000002.vtu", "bar_000004.vtu",
    ]  # fmt: skip
    # Five moments, upright: the bar lies along x, and bends down.
    heights = [moment.points[:, 2].min() for moment in drawn]
    assert len(heights) == 5 and (np.diff(heights) < 0).all()
    assert np.ptp(drawn[0].points, axis=0) == pytest.approx([1.0, 0.2, 0.2], abs=0.01)
    assert (tmp_path / "out/bar.pvd").read_text().count("<DataSet") == 3
    last = TetMesh.load(tmp_path / "bar.vtu", precision=ebb.float64).vertices.pos.to_numpy()
    assert last == pytest.approx(TetMesh.load(tmp_path / "bar.veg").vertices.pos.to_numpy(), abs=1e-6)
    frame = TetMesh.load(tmp_path / "out/bar_000004.vtu", precision=ebb.float64).vertices.pos.to_numpy()
    assert frame == pytest.approx(last)


def test_materials_and_what_wins_over_them(run, tmp_path):
    write_veg(tmp_path / "box.veg")
    mesh = fem_program.load_mesh(str(tmp_path / "box.veg"), 20, 0, False, Console())
    (found,) = fem_program.materials_of(mesh, None, None, None)
    assert (found.density, found.young, found.poisson, len(found.rows)) == (500, 30000, 0.25, 12)
    (found,) = fem_program.materials_of(mesh, 7.0, None, 3.0)
    assert (found.density, found.young, found.poisson) == (3, 7, 0.25)
    for material, text in (
        ("ENU, 500, 30000, 0.5", "material 'soft': poisson is 0.5"),
        ("ORTHOTROPIC, 1, 1, 1, 1, 0, 0, 0, 1, 1, 1", "must be ENU"),
    ):
        write_veg(tmp_path / "bad.veg", material)
        code, said = run("--mesh", "bad.veg", "--steps", 1)
        assert code == 1 and text in said


def test_forces_and_fixed_vertices_from_files(run, tmp_path):
    mesh = write_veg(tmp_path / "box.veg")
    np.save(tmp_path / "force.npy", np.full((mesh.vertices.size, 3), [0.0, 0.0, 50.0]))
    rows = np.flatnonzero(mesh.vertices.pos.to_numpy()[:, 0] == 0)
    np.save(tmp_path / "fixed.npy", rows)
    (tmp_path / "fixed.txt").write_text(", ".join(map(str, rows)))
    np.savetxt(tmp_path / "floats.txt", rows, header="as NumPy writes them")
    (tmp_path / "fixed.bou").write_text(",\n".join(str(row + 1) for row in rows))
    found = []
    for fixed in ("fixed.npy", "fixed.txt", "floats.txt", "fixed.bou", "x-"):
        words = ("--mesh", "box.veg", "--gravity", "0,0,0", "--force", "force.npy", "--fixed", fixed)
        code, text = run(*words, "--steps", 2, "--dump", "q.npz")
        assert code == 0, text
        with np.load(tmp_path / "q.npz") as states:
            found.append(states["q"][-1])
    assert (found[0][rows] == 0).all() and found[0][:, 2].max() > 0
    assert all((other == found[0]).all() for other in found)


def test_meshes_of_other_kinds(run, tmp_path):
    ball = TetMesh.ball(2)
    cells = ball.tetrahedra.v.to_numpy()
    np.savez(tmp_path / "ball.npz", V=ball.vertices.pos.to_numpy(), T=cells)
    TriMesh.icosphere(1).save(tmp_path / "ball.off")
    code, text = run("--mesh", "ball.npz", "--steps", 1)
    assert code == 0 and "turned" not in text
    assert run("--mesh", "ball.off", "--resolution", 4, "--steps", 1)[0] == 0
    code, text = run("--mesh", "ball.npz", "--steps", 1, "--refine", 1)
    assert code == 0 and "1280 tetrahedra" in text


def test_tetrahedra_of_the_other_convention_and_some_that_are_inverted(run, tmp_path):
    ball = TetMesh.ball(2)
    points, cells = ball.vertices.pos.to_numpy(), ball.tetrahedra.v.to_numpy()
    found = []
    for name, inverted, words in (
        ("ours", [], ()),
        ("other", slice(None), ()),
        ("other", slice(None), ("--fix-orientation",)),
        ("some", [7, 90], ("--fix-orientation",)),
    ):
        given = cells.copy()
        given[inverted] = given[inverted][:, [0, 1, 3, 2]]
        np.savez(tmp_path / f"{name}.npz", V=points, T=given)
        code, text = run("--mesh", f"{name}.npz", "--fixed", "x-", "--steps", 2, "--dump", "out.npz", *words)
        assert code == 0, text
        expected = {"ours": 0, "other": 1, "some": 1}
        assert text.count("turned") == expected[name]
        with np.load(tmp_path / "out.npz") as states:
            found.append(states["q"][-1])
    for each in found[1:]:
        np.testing.assert_allclose(each, found[0], rtol=0, atol=1e-9 * np.abs(found[0]).max())
    assert "2 of the 160 tetrahedra were inverted" in text
    code, text = run("--mesh", "some.npz", "--steps", 1)
    assert code == 1 and "tetrahedron 7 " in text and "2 of the 160 elements are inverted" in text
    assert "--fix-orientation turns them" in text


def test_rest(run, tmp_path):
    code, text = run("--static", "--resolution", 6, "--young", 1e6, "--dump", "rest.npz")
    assert code == 0 and "at rest" in text
    with np.load(tmp_path / "rest.npz") as states:
        assert states["q"].shape == (1, 63, 3) and (states["v"] == 0).all()
        assert -0.5 < states["q"][0, :, 1].min() < -0.01


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--poisson", 0.5), "poisson is 0.5"),
        (("--young", -1), "young is -1"),
        (("--density", 0), "density is 0"),
        (("--gravity", "1,2"), "--gravity is three numbers"),
        (("--fixed", "none.txt"), "neither a file of vertex numbers nor one of x-"),
        (("--fixed", "broken.txt"), "neither a file of vertex numbers"),
        (("--fixed", "part.npy"), "are integers, not 2.5"),
        (("--fixed", "far.txt"), "fixed vertex 99 is none of the 45 vertices"),
        (("--force", "none.npy"), "cannot be read"),
        (("--force", "short.npy"), "shape (45, 3)"),
        (("--force", "nan.npy"), "not finite in 1 rows, the first is 3"),
        (("--mesh", "none.veg"), "E701"),
        (("--mesh", "none.npz"), "cannot be read"),
        (("--mesh", "broken.npz"), "V (points) and T (corners)"),
        (("--mesh", "ball.veg", "--static"), "0 vertices are fixed"),
        (("--backend", "abacus"), "abacus"),
    ],
)
def test_what_is_wrong(run, tmp_path, words, text):
    (tmp_path / "broken.txt").write_text("3, vier")
    (tmp_path / "far.txt").write_text("99")
    np.save(tmp_path / "part.npy", [1, 2.5])
    np.save(tmp_path / "short.npy", np.zeros((2, 3)))
    np.save(tmp_path / "nan.npy", np.where(np.arange(45)[:, None] == 3, np.nan, np.zeros((45, 3))))
    np.savez(tmp_path / "broken.npz", V=np.zeros((4, 3)))
    TetMesh.ball(1).save(tmp_path / "ball.veg")
    code, said = run("--resolution", 4, "--steps", 2, *words)
    assert code == 1 and text in said.replace("\n", " "), said


def test_a_vertex_of_no_tetrahedron_stays(run, tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 5, 5]], dtype=float)
    np.savez(tmp_path / "lonely.npz", V=points, T=[[0, 1, 2, 3]])
    code, text = run("--mesh", "lonely.npz", "--steps", 2, "--dump", "out.npz")
    assert code == 0, text
    with np.load(tmp_path / "out.npz") as states:
        assert not states["q"][:, 4].any()
        np.testing.assert_allclose(states["v"][-1, :4, 1], 2 * 0.01 * -9.81, rtol=1e-5)


def test_a_failed_step_saves_the_last_good_state(run, tmp_path):
    words = ("--resolution", 4, "--steps", 50, "--gravity", "-4000,0,0", "--fixed", "x-")
    code, text = run(*words, law="neohookean")
    assert code == 1 and "tetrahedra turn over" in text and "last_good_state.npz" in text
    with np.load(tmp_path / "last_good_state.npz") as state:
        assert state["q"].shape == (1, 45, 3) and np.isfinite(state["q"]).all()
    code, text = run(*words, "--dump", "all.npz", law="neohookean")
    with np.load(tmp_path / "all.npz") as states:
        assert len(states["q"]) == len(states["iterations"]) == int(text.rpartition("step ")[2].split(":")[0]) - 1


def test_an_interrupt_saves_the_steps_that_were_made(run, tmp_path, monkeypatch):
    step = fem.SoftBody.step

    def step_or_stop(self, *arguments):
        done = step(self, *arguments)
        stops.append(done)
        if len(stops) == 3:
            raise KeyboardInterrupt
        return done

    stops = []
    monkeypatch.setattr(fem.SoftBody, "step", step_or_stop)
    code, text = run("--resolution", 2, "--steps", 50, "--dump", "all.npz", "--save", "last.veg")
    assert code == 1 and "interrupted after 2 steps" in text
    with np.load(tmp_path / "all.npz") as states:
        assert len(states["q"]) == 2
        last, mesh = states["q"][-1], TetMesh.load(tmp_path / "last.veg")
    start = TetMesh.box(2, 2, 2, (1.0, 0.2, 0.2)).vertices.pos.to_numpy()
    np.testing.assert_allclose(mesh.vertices.pos.to_numpy(), start + last, atol=1e-6)
