"""Pictures of moving surfaces, for the examples: several moments side by side on one floor, lit, with soft shadows.

PyVista draws them off-screen. Where it is not installed, or the machine has no OpenGL library for it, the software
renderer beside this file does.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import software

FLOOR = np.array([0.955, 0.945, 0.925])
SHADE = np.array([0.30, 0.30, 0.36])
CLAY = np.array([0.80, 0.36, 0.25])
SUN = np.array([-0.42, -0.50, 0.76]) / np.linalg.norm([-0.42, -0.50, 0.76])


@dataclass(frozen=True)
class Surface:
    """A surface to draw: ``points`` (n, 3) with z up, ``triangles`` (m, 3), RGB colours (n, 3), or one, from 0 to 1."""

    points: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray


@dataclass(frozen=True)
class Camera:
    """Where the picture is taken from; ``view_angle`` is that of its height, in degrees."""

    position: np.ndarray
    target: np.ndarray
    view_angle: float


@dataclass(frozen=True)
class Floor:
    """The rectangle of z = 0 with the corners ``low`` and ``high``; ``image`` (ny, nx, 3) is its colour."""

    low: np.ndarray
    high: np.ndarray
    image: np.ndarray


def save_strip(path: Path, moments: Sequence[Surface], width: int = 2200, elevation: float = 15.0) -> str:
    """Draw several moments side by side, from left to right, and say what drew them.

    Args:
        path: of the PNG file.
        moments: what is to be seen at each.
        width: of the picture, in pixels.
        elevation: how far from above it is seen, in degrees.
    """
    low = np.min([moment.points.min(axis=0) for moment in moments], axis=0)
    high = np.max([moment.points.max(axis=0) for moment in moments], axis=0)
    step = 1.12 * max(float(np.ptp(moment.points[:, 0])) for moment in moments)
    shift = step * (np.arange(len(moments)) - (len(moments) - 1) / 2)
    middle = (low + high) / 2 * [1, 1, 0]
    first = np.cumsum([0, *(len(moment.points) for moment in moments)])
    surface = Surface(
        np.concatenate([m.points - middle + [x, 0, 0] for m, x in zip(moments, shift, strict=True)]),
        np.concatenate([m.triangles + start for m, start in zip(moments, first, strict=False)]),
        np.concatenate([np.broadcast_to(m.colors, m.points.shape) for m in moments]),
    )
    # A long lens: the bodies at the ends are seen from the front, as the one in the middle.
    up = np.array([0, np.sin(np.radians(elevation)), np.cos(np.radians(elevation))])
    rise = surface.points @ up
    tall, wide = 1.16 * float(np.ptp(rise)), 1.04 * len(moments) * step
    target = up * (rise.min() + rise.max()) / 2 - 0.03 * tall * up
    height = round(width * tall / wide / 2) * 2
    distance = 5.0 * wide / 2
    camera = Camera(
        target + distance * np.array([0, -up[2], up[1]]), target, 2 * np.degrees(np.arctan(tall / 2 / distance))
    )
    return draw(path, surface, camera, (width, height))


def draw(path: Path, surface: Surface, camera: Camera, size: tuple[int, int]) -> str:
    """Draw the surface on its floor into a PNG file of ``size`` pixels, and say what drew it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    floor = cast_shadow(surface)
    missing = what_pyvista_lacks()
    if missing is None:
        _draw_pyvista(path, surface, floor, camera, size)
        return "PyVista"
    software.draw(path, surface, floor, camera, size, SUN)
    return f"the software renderer, since {missing}"


def cast_shadow(surface: Surface, samples: int = 64) -> Floor:
    """The floor with the shadow of the surface: the share of a round sun that each place does not see."""
    low, high = surface.points.min(axis=0)[:2], surface.points.max(axis=0)[:2]
    reach = surface.points[:, 2].max() * 1.2
    low, high = low - reach, high + reach
    cell = max(np.ptp(surface.points[:, 2]) / 150, np.ptp(surface.points, axis=0).max() / 900)
    shape = np.ceil((high - low) / cell).astype(int)
    points = _fine_points(surface.points[surface.triangles], 0.8 * cell)
    covered = np.zeros(shape[0] * shape[1])
    turn = np.pi * (3 - 5**0.5)
    for sample in range(samples):
        # A sunflower fills the disc of the sun evenly.
        radius, angle = 0.16 * np.sqrt((sample + 0.5) / samples), turn * sample
        ray = SUN[:2] / SUN[2] + radius * np.array([np.cos(angle), np.sin(angle)])
        index = ((points[:, :2] - points[:, 2:] * ray - low) / cell).astype(int)
        hit = np.zeros(len(covered), dtype=bool)
        hit[index[:, 0] * shape[1] + index[:, 1]] = True
        covered += hit
    shadow = _smooth(covered.reshape(shape) / samples).T[:, :, None]
    return Floor(low, high, FLOOR * (1 - shadow) + (0.45 * FLOOR + 0.55 * SHADE) * shadow)


def _fine_points(corners: np.ndarray, spacing: float) -> np.ndarray:
    """Points on triangles, of the shape (m, 3, 3), about as close to each other as ``spacing``."""
    found = []
    while len(corners):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        size = np.linalg.norm(np.cross(b - a, c - a), axis=1) ** 0.5
        found.append(corners[size <= spacing].mean(axis=1))
        a, b, c = (corner[size > spacing] for corner in (a, b, c))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.concatenate(found)


def _smooth(image: np.ndarray) -> np.ndarray:
    """Close the pinholes between the points that cast the shadow, and take its steps off."""
    for axis in (0, 1):
        image = np.maximum(image, np.minimum(np.roll(image, 1, axis), np.roll(image, -1, axis)))
    for _ in range(3):
        for axis in (0, 1):
            image = (np.roll(image, 1, axis) + 2 * image + np.roll(image, -1, axis)) / 4
    return image


def what_pyvista_lacks() -> str | None:
    """Why PyVista cannot draw here, or None. It is tried in a process of its own: without OpenGL, VTK crashes."""
    if importlib.util.find_spec("pyvista") is None:
        return 'PyVista is not installed (pip install "ebblang[viz]")'
    trial = "import pyvista; pyvista.Plotter(off_screen=True, window_size=[64, 64]).screenshot(return_img=True)"
    try:
        tried = subprocess.run([sys.executable, "-c", trial], capture_output=True, timeout=60)
    except subprocess.TimeoutExpired:
        return "PyVista hangs here"
    return None if tried.returncode == 0 else "PyVista finds no OpenGL here (on Debian: apt-get install libegl1)"


def _draw_pyvista(path: Path, surface: Surface, floor: Floor, camera: Camera, size: tuple[int, int]) -> None:
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    mesh = pv.PolyData.from_regular_faces(surface.points, surface.triangles)
    mesh.point_data["color"] = (255 * surface.colors).astype(np.uint8)
    # Drawn at twice the size and reduced, edges come out smooth whatever the OpenGL library can do.
    plotter = pv.Plotter(off_screen=True, window_size=[2 * size[0], 2 * size[1]], lighting="none")
    plotter.set_background(FLOOR.tolist())
    _add_floor(plotter, floor)
    plotter.add_mesh(
        mesh, scalars="color", rgb=True, smooth_shading=True, ambient=0.16, diffuse=0.86, specular=0.22,
        specular_power=22,
    )  # fmt: skip
    away = np.linalg.norm(camera.position - camera.target)
    for direction, color, intensity in (
        (SUN, "#fff1dc", 0.86),
        ((0.9, -0.6, 0.35), "#bcd3ff", 0.36),
        ((0.3, 0.9, 0.6), "#ffe2c4", 0.35),
        ((0.0, -0.4, -0.9), "#ffead8", 0.16),
    ):
        light = pv.Light(position=camera.target + away * np.asarray(direction), focal_point=camera.target, color=color)
        light.intensity = intensity
        plotter.add_light(light)
    plotter.camera.position, plotter.camera.focal_point = camera.position.tolist(), camera.target.tolist()
    plotter.camera.up, plotter.camera.view_angle = (0, 0, 1), camera.view_angle
    plotter.reset_camera_clipping_range()
    image = plotter.screenshot(return_img=True)
    plotter.close()
    tall, wide = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    halves = image[:tall, :wide, :3].astype(np.float64).reshape(tall // 2, 2, wide // 2, 2, 3)
    software.write_png(path, halves.mean(axis=(1, 3)))


def _add_floor(plotter, floor: Floor) -> None:
    import pyvista as pv

    (x0, y0), (x1, y1) = floor.low, floor.high
    corners = [(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)]
    plane = pv.PolyData.from_regular_faces(np.array(corners, dtype=float), np.array([[0, 1, 2, 3]]))
    plane.active_texture_coordinates = np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)])
    image = (255 * floor.image[::-1]).round().astype(np.uint8)
    plotter.add_mesh(plane, texture=pv.Texture(np.ascontiguousarray(image)), lighting=False)
