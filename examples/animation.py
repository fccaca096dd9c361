"""Pictures of dye and smoke, frames of them, and animated files.

In the plane dye is ink in water on white paper: what of the light is left falls exponentially with the amount (Beer and
Lambert). Smoke is lit from above in front of the night: in space the light goes down through it first, so that it
throws shadows on itself, and then to the eye along the second axis.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import typer

import software
from options import check_output
from outputs import replacing

ABSORBED = np.array([(0.15, 0.75, 1.6), (1.5, 0.45, 0.12), (0.25, 1.6, 0.75)])
"""How much each of the three inks takes from red, green and blue: saffron, a blue, and magenta."""
GLOW = np.array([(1.00, 0.62, 0.30), (0.40, 0.72, 1.00), (0.95, 0.42, 0.62)])
"""The colour that each of the three kinds of smoke scatters."""
PAPER, NIGHT = np.array([0.985, 0.975, 0.955]), np.array([0.035, 0.045, 0.085])
ANIMATED = (".gif", ".webp", ".png")


# ---- Pictures ----


def draw_fluid(dye: np.ndarray, look: str, height: int) -> np.ndarray:
    """A picture with values from 0 to 255, of the shape (rows, columns, 3), about ``height`` pixels high.

    Args:
        dye: three amounts in each cell, an array of the shape (nx, ny, 3) or (nx, ny, nz, 3); the last axis is up.
        look: ``ink``, or ``smoke``.
        height: of the picture; at least one pixel a cell, and as many for each.
    """
    if dye.ndim == 4:
        lit = see_through(dye, 24.0 / dye.shape[1])
    elif look == "ink":
        lit = PAPER * np.exp(-0.9 * dye @ ABSORBED)
    else:
        lit = glow(dye, np.ones(dye.shape[:2]))
    image = lit.transpose(1, 0, 2)[::-1]
    return 255 * enlarge(image, max(1, round(height / image.shape[0]))).clip(0, 1)


def glow(dye: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Smoke of one layer in front of the night."""
    amount = dye.sum(axis=-1, keepdims=True)
    color = dye @ GLOW / np.maximum(amount, 1e-9)
    cover = 1 - np.exp(-1.6 * amount)
    return NIGHT * (1 - cover) + color * light[..., None] * cover**0.8


def see_through(dye: np.ndarray, thickness: float) -> np.ndarray:
    """Smoke in space, seen along the second axis: an image of the shape (nx, nz, 3)."""
    amount = dye.sum(axis=-1)
    above = np.cumsum(amount[:, :, ::-1], axis=2)[:, :, ::-1] - amount
    light = 0.3 + 0.7 * np.exp(-0.45 * thickness * above)
    color = dye @ GLOW / np.maximum(amount, 1e-9)[..., None] * light[..., None]
    opacity = 1 - np.exp(-1.4 * thickness * amount)
    seen, left = np.zeros((*color.shape[:1], *color.shape[2:])), np.ones((dye.shape[0], dye.shape[2]))
    for layer in range(dye.shape[1]):
        seen += (left * opacity[:, layer])[..., None] * color[:, layer]
        left *= 1 - opacity[:, layer]
    return seen + left[..., None] * NIGHT


def enlarge(image: np.ndarray, times: int) -> np.ndarray:
    """So many pixels for each along both axes, with linear interpolation between their centres."""
    for axis in (0, 1):
        count = image.shape[axis]
        place = ((np.arange(count * times) + 0.5) / times - 0.5).clip(0, count - 1)
        first = np.minimum(place.astype(int), max(count - 2, 0))
        share = (place - first)[(slice(None), None, None) if axis == 0 else (None, slice(None), None)]
        after = np.minimum(first + 1, count - 1)
        image = np.take(image, first, axis) * (1 - share) + np.take(image, after, axis) * share
    return image


def save_moments(path: Path, moments: Sequence[np.ndarray]) -> None:
    """Write several pictures of one size side by side into a PNG file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    gap = np.full((moments[0].shape[0], 10, 3), 255.0)
    parts = [part for image in moments for part in (image, gap)]
    software.write_png(path, np.concatenate(parts[:-1], axis=1))


# ---- Frames ----


def check_outputs(picture: Path | None, frames: Path | None, animated: Path | None) -> None:
    """Refuse, before a program runs, pictures that it could not write: ``--save``, ``--frames`` and ``--animate``."""
    check_output("--save", picture, ".png")
    check_output("--frames", None if frames is None else frames / "frame-0001.png", ".png")
    check_output("--animate", animated, *ANIMATED)
    if animated is not None and importlib.util.find_spec("PIL") is None:
        raise typer.BadParameter('needs Pillow (pip install "ebblang[viz]")', param_hint="--animate")


class Film:
    """Frames, written one by one into a folder, and kept for an animated file.

    As a context it is saved at the end, whatever ended it: an interrupt leaves what has been filmed till then.
    """

    def __init__(self, folder: Path | None, animated: Path | None, per_second: float = 25.0) -> None:
        """Frames go to ``folder/frame-0001.png`` and on, and into the file ``animated``: GIF, WebP or animated PNG."""
        self.folder, self.animated, self.per_second = folder, animated, per_second
        self.count = 0
        self._kept: list[np.ndarray] = []

    @property
    def wanted(self) -> bool:
        """Whether frames go anywhere."""
        return self.folder is not None or self.animated is not None

    def add(self, image: np.ndarray) -> None:
        """Add a frame, an image with values from 0 to 255."""
        self.count += 1
        if self.folder is not None:
            software.write_png(self.folder / f"frame-{self.count:04}.png", image)
        if self.animated is not None:
            self._kept.append(np.rint(image).astype(np.uint8))

    def __enter__(self) -> Film:
        return self

    def __exit__(self, *_: object) -> None:
        if self.animated is None or not self._kept:
            return
        from PIL import Image

        frames = [Image.fromarray(frame) for frame in self._kept]
        if self.animated.suffix.lower() == ".gif":
            # One palette for all frames, from all: colours would flicker otherwise.
            sample = np.concatenate([frame[::4, ::4].reshape(-1, 3) for frame in self._kept])[None]
            palette = Image.fromarray(sample).quantize(255, Image.Quantize.MEDIANCUT)
            frames = [frame.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for frame in frames]
        duration = 1000 / self.per_second
        with replacing(self.animated) as part:
            frames[0].save(part, save_all=True, append_images=frames[1:], duration=duration, loop=0)
