"""A small software renderer: triangles sampled finer than the pixels, a depth buffer, and a PNG writer."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from outputs import replacing

if TYPE_CHECKING:
    from pictures import Camera, Floor, Surface

_CHUNK = 200_000


def draw(path: Path, surface: Surface, floor: Floor, camera: Camera, size: tuple[int, int], sun: np.ndarray) -> None:
    """Draw the surface and the floor into a PNG file of ``size`` pixels."""
    width, height = 2 * size[0], 2 * size[1]
    eye = _Eye(camera, width, height)
    image = eye.floor_colors(floor)
    depth, triangle, weights = _nearest(surface, eye)
    seen = np.isfinite(depth)
    corners = surface.triangles[triangle[seen]]
    normals = np.einsum("ni,nij->nj", weights[seen], point_normals(surface)[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colors = np.einsum("ni,nij->nj", weights[seen], surface.colors[corners])
    sky = 0.5 + 0.5 * normals[:, 2:]
    lit = np.maximum(normals @ sun, 0)[:, None]
    image[seen] = np.clip(colors * (0.24 + 0.22 * sky + 0.66 * lit * np.array([1.0, 0.96, 0.88])), 0, 1)
    image = image.reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))
    write_png(path, 255 * image)


def point_normals(surface: Surface) -> np.ndarray:
    """The normal at each point: that of its triangles, weighted by their areas."""
    a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.points)
    for i in range(3):
        np.add.at(normals, surface.triangles[:, i], face)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


class _Eye:
    """A camera as a perspective map from space to pixels."""

    def __init__(self, camera: Camera, width: int, height: int) -> None:
        self.position, self.size = np.asarray(camera.position, dtype=float), (width, height)
        forward = camera.target - self.position
        self.forward = forward / np.linalg.norm(forward)
        self.right = np.cross(self.forward, [0, 0, 1])
        self.right /= np.linalg.norm(self.right)
        self.up = np.cross(self.right, self.forward)
        self.scale = height / 2 / np.tan(np.radians(camera.view_angle / 2))

    def project(self, points: np.ndarray) -> np.ndarray:
        """Column, row and depth of each point."""
        offset = points - self.position
        depth = offset @ self.forward
        column = self.size[0] / 2 + self.scale * (offset @ self.right) / depth
        row = self.size[1] / 2 - self.scale * (offset @ self.up) / depth
        return np.stack([column, row, depth], axis=1)

    def floor_colors(self, floor: Floor) -> np.ndarray:
        """What each pixel shows of the floor, and its plain colour beyond its edges, shape (rows, columns, 3)."""
        columns, rows = (np.arange(n) + 0.5 for n in self.size)
        x = ((columns - self.size[0] / 2) / self.scale)[None, :, None] * self.right
        y = ((self.size[1] / 2 - rows) / self.scale)[:, None, None] * self.up
        ray = self.forward + x + y
        place = self.position[:2] - ray[..., :2] * (self.position[2] / np.minimum(ray[..., 2:], -1e-6))
        shape = np.array(floor.image.shape[1::-1])
        index = ((place - floor.low) / (floor.high - floor.low) * shape).astype(int)
        inside = ((index >= 0) & (index < shape)).all(axis=2) & (ray[..., 2] < 0)
        image = np.empty((*inside.shape, 3))
        image[:] = floor.image[0, 0]
        image[inside] = floor.image[index[inside][:, 1], index[inside][:, 0]]
        return image


def _nearest(surface: Surface, eye: _Eye) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each pixel the depth, the triangle and the barycentric weights of what is nearest."""
    width, height = eye.size
    depth = np.full(width * height, np.inf)
    triangle = np.zeros(width * height, dtype=np.int64)
    weights = np.zeros((width * height, 3))
    screen = eye.project(surface.points)
    corners = screen[surface.triangles]
    low = np.clip(np.ceil(corners[:, :, :2].min(axis=1) - 0.5), 0, eye.size).astype(int)
    high = np.clip(np.floor(corners[:, :, :2].max(axis=1) - 0.5) + 1, 0, eye.size).astype(int)
    sides = np.maximum(high - low, 0)
    count = sides.prod(axis=1)
    for start in range(0, len(corners), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        which = np.repeat(np.arange(len(corners))[chunk], count[chunk])
        place = np.arange(len(which)) - np.repeat(np.cumsum(count[chunk]) - count[chunk], count[chunk])
        column = low[which, 0] + place % np.maximum(sides[which, 0], 1)
        row = low[which, 1] + place // np.maximum(sides[which, 0], 1)
        w = _weights(corners[which], column + 0.5, row + 0.5)
        inside = (w >= 0).all(axis=1)
        which, w, pixel = which[inside], w[inside], (row * width + column)[inside]
        z = np.einsum("ni,ni->n", w, corners[which, :, 2])
        order = np.lexsort((z, pixel))
        first = order[np.flatnonzero(np.diff(pixel[order], prepend=-1))]
        first = first[z[first] < depth[pixel[first]]]
        depth[pixel[first]], triangle[pixel[first]], weights[pixel[first]] = z[first], which[first], w[first]
    shape = (height, width)
    return depth.reshape(shape), triangle.reshape(shape), weights.reshape(*shape, 3)


def _weights(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The barycentric weights of the pixel (x, y) in each triangle; -1 where it is seen edge on."""
    (ax, ay), (bx, by), (cx, cy) = (corners[:, i, :2].T for i in range(3))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
        v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
    found = np.stack([u, v, 1 - u - v], axis=1)
    return np.where(np.isfinite(found), found, -1)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write RGB values from 0 to 255, of the shape (rows, columns, 3)."""
    rows = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    height, width, _ = rows.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), rows.reshape(height, -1)], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    with replacing(path) as part:
        part.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
