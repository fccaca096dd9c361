"""What every program refuses before it runs: outputs that it could not write, numbers that mean nothing, no mesh."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import ebb
from options import check_output, finite, positive

PROGRAMS = {
    "fem_corotational": ("--save", "--dump"),
    "fem_neohookean": ("--save", "--dump"),
    "fem_stvk": ("--save", "--dump"),
    "fluids_fft": ("--save", "--dump"),
    "grid_particles": ("--save",),
    "heat": ("--save",),
    "lulesh": ("--save", "--dump"),
    "rendermesh": ("--save",),
    "smoothing": ("--save",),
    "spring_mass": ("--save",),
    "stable_fluids": ("--save", "--animate"),
}
"""The options for files of each program."""

NUMBERS = {
    "--dt": ("0", "-1", "nan", "inf"),
    "--threads": ("0",),
    "--steps": ("0",),
    "--iterations": ("0",),
    "--size": ("0",),
    "--grid": ("1",),
    "--resolution": ("0",),
    "--particles": ("0",),
    "--viscosity": ("-1", "inf"),
    "--diffusion": ("-1", "nan"),
    "--diffusivity": ("0", "nan"),
    "--tolerance": ("-1", "nan"),
    "--damping-mass": ("-1", "nan"),
    "--damping-stiffness": ("-1", "inf"),
    "--noise": ("-1", "nan"),
    "--force": ("nan",),
    "--turns": ("inf",),
    "--drop": ("-1", "nan"),
    "--sort": ("-1",),
}
"""Values that no program can take which has the option."""

MESHES = ("heat", "rendermesh", "smoothing", "spring_mass", "fem_stvk")


@pytest.fixture(params=PROGRAMS)
def program(request, tmp_path, monkeypatch):
    """A program by its name, and what runs it in an empty folder, and says what it says, without line breaks."""
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(importlib.import_module(request.param).main)

    def run(*words: str) -> tuple[int, str]:
        with ebb.backend("cpu"):
            result = CliRunner().invoke(app, words)
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        said = f"{result.output} {result.exception}".replace("│", " ")
        return result.exit_code, " ".join(said.split())

    return request.param, run


@pytest.fixture
def idle(monkeypatch):
    """No program may get as far as to choose its backend."""

    def begun(*_, **__):
        raise AssertionError("the program has begun to run")

    monkeypatch.setattr(ebb, "set_backend", begun)


def test_files_that_cannot_be_written(program, idle):
    name, run = program
    Path("file").write_text("")
    for option in PROGRAMS[name]:
        ending = {"--dump": ".npz", "--animate": ".gif"}.get(option, ".png")
        for path, text in (
            (f"new/out.{ending}.what", f"{option}: new/out.{ending}.what should end in"),
            (f"file/out{ending}", "cannot be written"),
            (f"{'long' * 99}{ending}", "cannot be written"),
        ):
            code, said = run(option, path)
            assert code == 2 and text in said, said
    assert [path.name for path in Path().iterdir()] == ["file"]


def test_numbers_that_mean_nothing(program, idle):
    name, run = program
    options = run("--help")[1]
    taken = [(option, value) for option in NUMBERS if f"{option} " in options for value in NUMBERS[option]]
    assert len(taken) >= 3
    for option, value in taken:
        if name.startswith("fem") and option == "--force":  # the name of a file
            continue
        code, said = run(option, value)
        assert code == 2 and f"'{option}'" in said, said


@pytest.mark.parametrize("program", MESHES, indirect=True)
def test_meshes_that_are_not_there(program):
    code, said = program[1]("--mesh", "none.off", "--save", "out.png")
    assert code == 1 and "E701" in said and "none.off" in said
    assert not list(Path().iterdir())


def test_formats_that_need_a_package(monkeypatch, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(typer.BadParameter, match="need meshio"):
        check_output("--save", tmp_path / "out.vtu", ".vtu")
    check_output("--save", tmp_path / "OUT.PNG", ".png", ".vtu")
    check_output("--save", None, ".png")


def test_callbacks_let_pass_what_is_right():
    assert positive(None) is None and finite(None) is None
    assert positive(0.5) == 0.5 and finite(-2.0) == -2.0
