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
SUN = np.array([-0.42, -0.50, 0.76]) / np.linalg.norm([-0.42, -0.50, 0.76])


@dataclass(frozen=True)
class Surface:
    """A surface to draw: ``points`` (n, 3) with z up, ``triangles`` (m, 3), and RGB colours (n, 3) from 0 to 1."""

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


def save_strip(
    path: Path, moments: Sequence[np.ndarray], triangles: np.ndarray, colors: np.ndarray, width: int = 2200
) -> str:
    """Draw the surface at several moments, from left to right, and say what drew it.

    Args:
        path: of the PNG file.
        moments: the points at each, of the shape (n, 3), z up, above the floor z = 0.
        triangles: shape (m, 3).
        colors: RGB from 0 to 1, of the shape (n, 3), or (3,) for one.
        width: in pixels.
    """
    everything = np.concatenate(moments)
    low, high = everything.min(axis=0), everything.max(axis=0)
    step = 1.12 * max(np.ptp(points[:, 0]) for points in moments)
    shift = np.arange(len(moments)) - (len(moments) - 1) / 2
    middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, 0])
    placed = [points - middle + [offset * step, 0, 0] for points, offset in zip(moments, shift, strict=True)]
    surface = Surface(
        np.concatenate(placed),
        np.concatenate([triangles + i * len(colored(moments[0], colors)) for i in range(len(placed))]),
        np.concatenate([colored(points, colors) for points in placed]),
    )
    wide, tall = len(moments) * step * 1.04, (high[2] - min(low[2], 0)) * 1.22
    height = round(width * tall / wide / 2) * 2
    # A long lens: the bodies at the ends are seen from the front, as the one in the middle.
    angle = 13.0 * height / width * 2.2
    distance = tall / 2 / np.tan(np.radians(angle / 2))
    target = np.array([0, 0, tall / 2 - 0.09 * tall])
    camera = Camera(target + distance * np.array([0, -0.965, 0.26]), target, angle)
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


def colored(points: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """One colour, or one for each point, as an array of the shape of ``points``."""
    return np.broadcast_to(colors, points.shape)


def cast_shadow(surface: Surface, samples: int = 64) -> Floor:
    """The floor with the shadow of the surface: the share of a round sun that each place does not see."""
    low, high = surface.points.min(axis=0)[:2], surface.points.max(axis=0)[:2]
    reach = surface.points[:, 2].max() * 1.2
    low, high = low - reach, high + reach
    cell = np.ptp(surface.points[:, 2]) / 150
    shape = np.ceil((high - low) / cell).astype(int)
    points = surface.points
    if len(points) < 100_000:
        points = np.concatenate([points, points[surface.triangles].mean(axis=1)])
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
