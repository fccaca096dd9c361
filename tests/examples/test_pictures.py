"""The pictures: that something is to be seen, where it should be."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

import pictures
import software
from ebb.domains import TriMesh
from pictures import CLAY, FLOOR, Surface


def read_png(path):
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    start = data.index(b"IDAT") + 4
    size = struct.unpack(">I", data[start - 8 : start - 4])[0]
    lines = np.frombuffer(zlib.decompress(data[start : start + size]), np.uint8).reshape(height, 1 + 3 * width)
    return lines[:, 1:].reshape(height, width, 3)


def sphere(height, colors=CLAY):
    mesh = TriMesh.icosphere(3, 0.5)
    points = mesh.vertices.pos.to_numpy() + np.array([0, 0, 0.5 + height])
    return Surface(points, mesh.triangles.v.to_numpy(), colors)


def reddish(image):
    pixels = image.astype(int)
    return pixels[:, :, 0] > pixels[:, :, 2] + 40


def test_png_keeps_pixels(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, size=(5, 7, 3))
    software.write_png(tmp_path / "a.png", image)
    assert np.array_equal(read_png(tmp_path / "a.png"), image)


def test_software_strip_shows_each_moment_at_its_place(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "what_pyvista_lacks", lambda: "it is a test")
    drawn = pictures.save_strip(tmp_path / "out" / "strip.png", [sphere(0.8), sphere(0.0)], width=300)
    assert drawn == "the software renderer, since it is a test"
    image = read_png(tmp_path / "out" / "strip.png")
    body = reddish(image)
    rows = [np.flatnonzero(half.any(axis=1)).mean() for half in (body[:, :150], body[:, 150:])]
    assert rows[0] < rows[1] - 30, "the first sphere is higher"
    # Each is a disc of the share of the width that the layout gives it.
    share = body.sum() / 2 / (np.pi / 4 * (150 / (1.12 * 1.04)) ** 2)
    assert share == pytest.approx(1, abs=0.08)
    assert image[0, 0].tolist() == (255 * FLOOR).round().astype(int).tolist()


def test_shadow_lies_beside_the_foot_and_is_darkest_there():
    near, far = pictures.cast_shadow(sphere(0.0)), pictures.cast_shadow(sphere(1.0))
    assert near.image.min() < far.image.min() + 0.02
    assert near.image.max() == pytest.approx(FLOOR.max())
    dark = np.argwhere(near.image[:, :, 0] < FLOOR[0] - 0.1).mean(axis=0)[::-1]
    place = near.low + dark / near.image.shape[1::-1] * (near.high - near.low)
    assert place == pytest.approx(-pictures.SUN[:2] / pictures.SUN[2] * 0.5, abs=0.05)


def test_colours_of_points_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "what_pyvista_lacks", lambda: "it is a test")
    points = sphere(0).points
    halves = np.where(points[:, :1] < 0, [0.9, 0.1, 0.1], [0.1, 0.1, 0.9])
    pictures.save_strip(tmp_path / "strip.png", [Surface(points, sphere(0).triangles, halves)], width=120)
    image = read_png(tmp_path / "strip.png").astype(int)
    middle = image[image.shape[0] // 2]
    assert middle[40, 0] > 2 * middle[40, 2] and middle[80, 2] > 2 * middle[80, 0]


def test_pyvista_draws_the_same_scene(tmp_path, monkeypatch):
    lacking = pictures.what_pyvista_lacks()
    if lacking is not None:
        pytest.skip(lacking)
    monkeypatch.setattr(pictures, "what_pyvista_lacks", lambda: None)  # which tries it in a process of its own
    moments = [sphere(0.4), sphere(0.0)]
    assert pictures.save_strip(tmp_path / "gl.png", moments, width=240) == "PyVista"
    monkeypatch.setattr(pictures, "what_pyvista_lacks", lambda: "it is a test")
    pictures.save_strip(tmp_path / "software.png", moments, width=240)
    one, other = reddish(read_png(tmp_path / "gl.png")), reddish(read_png(tmp_path / "software.png"))
    assert (one & other).sum() / (one | other).sum() > 0.93


def test_without_pyvista_the_reason_is_given(monkeypatch):
    monkeypatch.setattr(pictures.importlib.util, "find_spec", lambda name: None)
    assert "not installed" in pictures.what_pyvista_lacks()


def test_a_pyvista_that_crashes_is_not_used(monkeypatch):
    pytest.importorskip("pyvista")
    monkeypatch.setattr(pictures.sys, "executable", "/bin/false")
    assert "no OpenGL" in pictures.what_pyvista_lacks()
