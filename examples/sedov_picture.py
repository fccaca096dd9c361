"""The octant of a Sedov blast as a surface to draw, in the colours of its density."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from pictures import Surface


@dataclass(frozen=True)
class Moment:
    """Where the nodes are at some time, shape (n + 1, n + 1, n + 1, 3), and the density of the zones, (n, n, n)."""

    x: np.ndarray
    density: np.ndarray


def skin(shown: Moment) -> Surface:
    """The sides of the octant, each zone in the colour of its density, turned so that the origin is in front on top."""
    points, colors = [], []
    for axis, end in itertools.product(range(3), (0, -1)):
        x, density = shown.x.take(end, axis), shown.density.take(end, axis)
        quads = np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2)
        points.append((quads if (axis == 1) == (end == 0) else quads[:, :, ::-1]).reshape(-1, 3))
        colors.append(np.repeat(density_colors(density.ravel()), 4, axis=0))
    a, b, c = np.concatenate(points).T
    turned = np.stack([(b - a) / 2**0.5, (a + b) / 2**0.5, c.max() - c], axis=1)
    quads = np.arange(len(turned)).reshape(-1, 4)
    return Surface(turned, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), np.concatenate(colors))


def density_colors(density: np.ndarray) -> np.ndarray:
    """From the dark of the emptied middle over the grey of gas at rest to the fire of the shock, RGB from 0 to 1."""
    stops = np.array([(0.05, 0.04, 0.15), (0.35, 0.12, 0.40), (0.72, 0.73, 0.76), (0.95, 0.55, 0.15), (1.0, 0.9, 0.5)])
    places = [0.0, 0.5, 1.0, 2.0, 4.0]
    return np.stack([np.interp(density, places, channel) for channel in stops.T], axis=1)
