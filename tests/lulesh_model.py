"""The Sedov problem of LULESH 2.0 in plain NumPy, array by array, to hold the example against.

Written from the description of the problem (LLNL-TR-490254) and of its updates (LLNL-TR-641973), independently of the
example: gradients of volumes are exact differences here, limits and cuts stand where the reports have them. Zones and
nodes are numbered with x fastest.
"""

from __future__ import annotations

import numpy as np

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
FACES = np.array([(0, 1, 2, 3), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0), (4, 7, 6, 5)])
SHAPES = np.array(
    [[1, 1, -1, -1, -1, -1, 1, 1], [1, -1, -1, 1, -1, 1, 1, -1], [1, -1, 1, -1, 1, -1, 1, -1],
     [-1, 1, -1, 1, 1, -1, 1, -1]]
)  # fmt: skip
# The corners at the far and the near end of each axis.
ENDS = (((1, 2, 6, 5), (0, 3, 7, 4)), ((3, 2, 6, 7), (0, 1, 5, 4)), ((4, 5, 6, 7), (0, 1, 2, 3)))


def volumes(x):
    """Of hexahedra with corners of the shape (m, 8, 3): half the sum over both ways of cutting each face in two."""
    total = 0.0
    for face in FACES:
        a, b, c, d = (x[:, i] for i in face)
        total = total - (det(a, b, c) + det(a, c, d) + det(a, b, d) + det(b, c, d))
    return total / 12


def det(a, b, c):
    return np.einsum("ij,ij->i", np.cross(a, b), c)


def volume_gradients(x):
    """A volume is linear in each single coordinate, so a difference is the derivative."""
    gradients = np.empty_like(x)
    for i in range(8):
        for axis in range(3):
            moved = x.copy()
            moved[:, i, axis] += 1.0
            gradients[:, i, axis] = volumes(moved)
            moved[:, i, axis] -= 2.0
            gradients[:, i, axis] -= volumes(moved)
    return gradients / 2


def shape_gradients(x):
    """Those of the shape functions at the centre, times the volume there, and that volume."""
    along = 2.0 * CORNERS - 1
    jacobian = np.einsum("mna,nb->mba", x, along) / 8
    inverse = np.linalg.inv(jacobian)
    volume = 8 * np.linalg.det(jacobian)
    return np.einsum("mab,nb->mna", inverse, along) / 8 * volume[:, None, None], volume


def node_normals(x):
    """A quarter of each face's area, outwards, to each of its corners."""
    normals = np.zeros_like(x)
    for face in FACES:
        a, b, c, d = (x[:, i] for i in face)
        area = np.cross((c + d - a - b) / 2, (b + c - a - d) / 2) / 4
        for i in face:
            normals[:, i] += area
    return normals


def lengths(x, volume):
    largest = 0.0
    for face in FACES:
        a, b, c, d = (x[:, i] for i in face)
        f, g = (c - a) - (d - b), (c - a) + (d - b)
        square = (f * f).sum(1) * (g * g).sum(1) - (f * g).sum(1) ** 2
        largest = np.maximum(largest, square)
    return 4 * volume / np.sqrt(largest)


class Model:
    """``cycle()`` advances; the arrays have the names of the reference."""

    def __init__(self, n):
        self.n = n
        axis = np.arange(n + 1) * 1.125 / n
        z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
        self.x = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        k, j, i = (a.ravel() for a in np.indices((n, n, n)))
        node = (i + (n + 1) * (j + (n + 1) * k))[:, None]
        self.corners = node + CORNERS @ [1, n + 1, (n + 1) ** 2]
        self.xd = np.zeros_like(self.x)
        m = n**3
        for name in ("e", "p", "q", "ss", "vdov", "delv", "length"):
            setattr(self, name, np.zeros(m))
        self.v = np.ones(m)
        self.volo = volumes(self.x[self.corners])
        self.mass = np.zeros(len(self.x))
        np.add.at(self.mass, self.corners, self.volo[:, None] / 8)
        self.e[0] = 3.948746e7 * (n / 45) ** 3
        self.dt, self.time, self.cycles = 0.5 * np.cbrt(self.volo[0]) / np.sqrt(2 * self.e[0]), 0.0, 0
        self.courant = self.hydro = 1e20

    def run(self, cycles):
        while cycles and self.time < 1e-2:
            self.choose_step()
            self.move_nodes()
            self.advance_zones()
            cycles -= 1

    def choose_step(self):
        left = 1e-2 - self.time
        if self.cycles:
            new = 1e20
            if self.courant < new:
                new = self.courant / 2
            if self.hydro < new:
                new = self.hydro * 2 / 3
            ratio = new / self.dt
            if 1 <= ratio < 1.1:
                new = self.dt
            elif ratio > 1.2:
                new = self.dt * 1.2
            self.dt = min(new, 1e-2)
        if self.dt < left < 4 * self.dt / 3:
            left = 2 * self.dt / 3
        self.dt = min(self.dt, left)
        self.time += self.dt
        self.cycles += 1

    def move_nodes(self):
        x, u = self.x[self.corners], self.xd[self.corners]
        volume = self.volo * self.v
        force = (self.p + self.q)[:, None, None] * node_normals(x)
        gradient = volume_gradients(x)
        mode = SHAPES - np.einsum("mna,mka->mkn", gradient, np.einsum("kn,mna->mka", SHAPES, x)) / volume[:, None, None]
        strength = -3.0 * 0.01 * self.ss * self.volo / np.cbrt(volume)
        force += strength[:, None, None] * np.einsum("mkn,mka->mna", mode, np.einsum("mkn,mna->mka", mode, u))
        total = np.zeros_like(self.x)
        np.add.at(total, self.corners, force)
        acceleration = total / self.mass[:, None]
        for axis in range(3):
            acceleration[self.x[:, axis] == 0, axis] = 0
        self.xd = self.xd + acceleration * self.dt
        self.xd[np.abs(self.xd) < 1e-7] = 0
        self.x = self.x + self.xd * self.dt

    def advance_zones(self):
        x, u = self.x[self.corners], self.xd[self.corners]
        volume = volumes(x)
        new = volume / self.volo
        self.delv, self.length = new - self.v, lengths(x, volume)
        gradient, middle = shape_gradients(x - u * self.dt / 2)
        self.vdov = np.einsum("mna,mna->m", gradient, u) / middle
        linear, quadratic = self.viscosity(x, u, new)
        self.advance_gas(new, linear, quadratic)
        self.v = np.where(np.abs(new - 1) < 1e-10, 1.0, new)
        squares = self.ss**2 + np.where(self.vdov < 0, 64 * 2.0**2 * self.length**2 * self.vdov**2, 0)
        moving = self.vdov != 0
        self.courant = (self.length / np.sqrt(np.maximum(squares, 1e-300)))[moving].min(initial=1e20)
        self.hydro = (0.1 / (np.abs(self.vdov) + 1e-20))[moving].min(initial=1e20)

    def viscosity(self, x, u, new):
        """The linear and the quadratic part of the artificial viscosity."""
        volume = self.volo * new
        way = [(x[:, list(far)].sum(1) - x[:, list(near)].sum(1)) / 4 for far, near in ENDS]
        speed = [(u[:, list(far)].sum(1) - u[:, list(near)].sum(1)) / 4 for far, near in ENDS]
        n, first, second = self.n, 0.0, 0.0
        for axis in range(3):
            area = np.cross(way[(axis + 1) % 3], way[(axis + 2) % 3])
            delx = volume / np.sqrt((area**2).sum(1) + 1e-36)
            delv = (area / (volume + 1e-36)[:, None] * speed[axis]).sum(1)
            grid = np.moveaxis(delv.reshape(n, n, n), 2 - axis, 0)
            below, above = np.concatenate([grid[:1], grid[:-1]]), np.concatenate([grid[1:], 0 * grid[:1]])
            norm = 1 / (grid + 1e-36)
            below, above = below * norm, above * norm
            limit = np.clip(np.minimum((below + above) / 2, 2 * np.minimum(below, above)), 0, 1)
            limit = np.moveaxis(limit, 0, 2 - axis).ravel()
            inward = np.minimum(delv * delx, 0)
            first, second = first + inward * (1 - limit), second + inward**2 * (1 - limit**2)
        density = self.volo / volume
        shrinking = self.vdov <= 0
        return -0.5 * density * first * shrinking, 2 / 3 * density * second * shrinking

    def advance_gas(self, new, linear, quadratic):
        """Energy, pressure and viscosity by a step of three parts, with the pressure at half time in the middle."""
        delv, old = self.delv, self.p + self.q
        compression, half = 1 / new - 1, 1 / (new - delv / 2) - 1

        def pressure(energy, comp):
            found = 2 / 3 * (comp + 1) * energy
            return np.maximum(np.where(np.abs(found) < 1e-7, 0, found), 0)

        def sound(energy, size, comp, press):
            square = 2 / 3 * energy + size**2 * (2 / 3 * (comp + 1)) * press
            return np.where(square <= 0.1111111e-36, 0.3333333e-18, np.sqrt(np.maximum(square, 0)))

        def cut(energy):
            return np.where(np.abs(energy) < 1e-7, 0, energy)

        energy = self.e - delv * old / 2
        half_pressure = pressure(energy, half)
        q = np.where(delv > 0, 0, sound(energy, 1 / (1 + half), half, half_pressure) * linear + quadratic)
        energy = cut(energy + delv / 2 * (3 * old - 4 * (half_pressure + q)))
        now = pressure(energy, compression)
        tilde = np.where(delv > 0, 0, sound(energy, new, compression, now) * linear + quadratic)
        energy = cut(energy - (7 * old - 8 * (half_pressure + q) + now + tilde) * delv / 6)
        now = pressure(energy, compression)
        last = sound(energy, new, compression, now) * linear + quadratic
        self.q = np.where(delv <= 0, np.where(np.abs(last) < 1e-7, 0, last), q)
        self.e, self.p = energy, now
        self.ss = sound(energy, new, compression, now)
