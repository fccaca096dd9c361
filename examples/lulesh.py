"""LULESH 2.0: the Sedov blast on an octant, by Lagrangian hydrodynamics on a mesh of hexahedra that moves with the gas.

The problem and its numbers are those of the Livermore Unstructured Lagrangian Explicit Shock Hydrodynamics proxy
(Hornung, Keasler and Gokhale, "Hydrodynamics Challenge Problem", LLNL-TR-490254; Karlin, Keasler and Neely, "LULESH
2.0 Updates and Changes", LLNL-TR-641973). Energy lies in the zone at the origin, the planes through the origin are
planes of symmetry, the other sides are free. A cycle

- adds up the forces of zones on nodes: pressure, and viscosity against hourglassing (Flanagan and Belytschko, 1981);
- moves the nodes;
- takes from the new shape of each zone its volume, its rate of expansion, and the gradient of the velocity;
- finds the artificial viscosity of shocks, limited to keep smooth flow (Christensen, 1990, after van Leer);
- advances energy, pressure and viscosity of an ideal gas, region by region, and finds the next time step.

The same kernels run on two meshes: one with keys of corners and neighbours, as codes for any mesh have, and a grid.

    python examples/lulesh.py --size 30
    python examples/lulesh.py --size 45 --regions 1 --mesh grid --save out/sedov.png
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

import ebb
from ebb.domains import HexGrid, HexMesh
from lulesh_regions import draw_regions, evaluations
from options import Backend, Threads, check_output
from outputs import save_arrays
from whole_steps import run_whole

if TYPE_CHECKING:
    from sedov_picture import Moment

SIDE = 1.125  # the length of the octant
ORIGIN_ENERGY = 3.948746e7 / 45**3  # in the zone at the origin, times the number of zones
STOP_TIME = 1e-2
DENSITY = 1.0  # of the gas at the start

# The gas is ideal, with gamma = 5/3: p = (gamma - 1) rho e.
GAS = 2 / 3
# Limits are constants: that they are no NaN saves a comparison wherever the larger of two numbers is taken.
SMALLEST_ENERGY = ebb.constant(-1e15, ebb.float64)
SMALLEST_VOLUME, LARGEST_VOLUME = (ebb.constant(limit, ebb.float64) for limit in (1e-9, 1e9))  # of zones, relative
ENERGY_CUT = PRESSURE_CUT = VISCOSITY_CUT = VELOCITY_CUT = 1e-7  # what is smaller is 0
VOLUME_CUT = 1e-10  # relative volumes as near to 1 are 1

HOURGLASS = 3.0 * 0.01
LINEAR, QUADRATIC = 0.5, 2 / 3  # the coefficients of the artificial viscosity
LARGEST_VISCOSITY = 1e12
SLOWEST_SOUND = 1e-18 / 3
COURANT_VISCOSITY = 8 * 2.0  # how much the viscosity counts against the time step
LARGEST_CHANGE = 0.1  # of a volume in a time step
LARGEST_STEP = 1e-2
LEAST_GROWTH, MOST_GROWTH = 1.1, 1.2  # of the time step, from cycle to cycle; less than the least is none
TINY, HUGE = 1e-36, 1e20

AXES = (0, 1, 2)
MESHES = {"unstructured": HexMesh, "grid": HexGrid}

# Temporaries of zones that are done with before others begin lie in the same fields: the gradient of the velocity and
# the thickness along each axis in those of the viscosity and the gas. `find_kinematics` writes them when `add_forces`
# has read the speed of sound; `find_viscosity` reads them last and writes its terms, `evaluate_gas` all the others.
DU = ("new_e", "new_p", "new_q")
DX = ("linear_q", "quadratic_q", "sound_speed")

dt = ebb.Global(ebb.float64, 0.0)
courant = ebb.Global(ebb.float64, HUGE)
hydro = ebb.Global(ebb.float64, HUGE)


# ---- Geometry of a hexahedron with the corners x[0] to x[7], numbered as everywhere: four below, four above ----


@ebb.func
def corners(z, field):
    return (
        z.corner(0)[field], z.corner(1)[field], z.corner(2)[field], z.corner(3)[field],
        z.corner(4)[field], z.corner(5)[field], z.corner(6)[field], z.corner(7)[field],
    )  # fmt: skip


@ebb.func
def axes(x):
    """How a point goes from face to face along each of the three axes through the centre."""
    a, b, c, d = x[6] - x[0], x[5] - x[3], x[7] - x[1], x[4] - x[2]
    return 0.25 * (a + b - c - d), 0.25 * (a - b + c - d), 0.25 * (a + b + c + d)


@ebb.func
def faces(x):
    """Four times the outward normals of the corners of each face: the cross products of its diagonals."""
    return (
        ebb.cross(x[3] - x[1], x[2] - x[0]),
        ebb.cross(x[1] - x[4], x[5] - x[0]),
        ebb.cross(x[2] - x[5], x[6] - x[1]),
        ebb.cross(x[3] - x[6], x[7] - x[2]),
        ebb.cross(x[0] - x[7], x[4] - x[3]),
        ebb.cross(x[5] - x[7], x[6] - x[4]),
    )


@ebb.func
def volume(x):
    """The volume of the trilinear hexahedron (Grandy, "Efficient Computation of Volume of Hexahedral Cells", 1997)."""
    return (
        ebb.dot(x[3] - x[1] + x[7] - x[2], ebb.cross(x[6] - x[3], x[2] - x[0]))
        + ebb.dot(x[4] - x[3] + x[5] - x[7], ebb.cross(x[6] - x[4], x[7] - x[0]))
        + ebb.dot(x[1] - x[4] + x[2] - x[5], ebb.cross(x[6] - x[1], x[5] - x[0]))
    ) / 12


@ebb.func
def volume_gradient(a, b, c, d, e, f):
    """How the volume grows as a corner moves, by the corners around it: a, c and d are its neighbours along edges."""
    return (ebb.cross(b + c, a + b) + ebb.cross(a + e, d + e) + ebb.cross(d + f, c + f)) / 12


@ebb.func
def volume_gradients(x):
    return (
        volume_gradient(x[1], x[2], x[3], x[4], x[5], x[7]),
        volume_gradient(x[2], x[3], x[0], x[5], x[6], x[4]),
        volume_gradient(x[3], x[0], x[1], x[6], x[7], x[5]),
        volume_gradient(x[0], x[1], x[2], x[7], x[4], x[6]),
        volume_gradient(x[7], x[6], x[5], x[0], x[3], x[1]),
        volume_gradient(x[4], x[7], x[6], x[1], x[0], x[2]),
        volume_gradient(x[5], x[4], x[7], x[2], x[1], x[3]),
        volume_gradient(x[6], x[5], x[4], x[3], x[2], x[0]),
    )


@ebb.func
def hourglass_modes(x):
    """The four patterns of signs at the corners that neither strain nor rotate the hexahedron, summed over ``x``."""
    a, b, c, d = x[0] + x[1], x[2] + x[3], x[4] + x[5], x[6] + x[7]
    e, f, g, h = x[0] - x[1], x[2] - x[3], x[4] - x[5], x[6] - x[7]
    return (a - b) - (c - d), (e - f) - (g - h), (e + f) + (g + h), (g + h) - (e + f)


# ---- Forces on nodes ----


@ebb.func
def hourglass_forces(x, u, zone_volume):
    """What resists the hourglassing of a zone with corners ``x`` and their velocities ``u``, for a viscosity of 1.

    Flanagan and Belytschko, "A uniform strain hexahedron and quadrilateral with orthogonal hourglass control" (1981),
    equations 33 to 50. The modes are made orthogonal to linear velocities by the gradients of the volume, g:
    gamma[m, i] = sign[m, i] - g[i] . X[m] / V, where X[m] is the mode of the corners. Forces are
    gamma^T gamma u; the part of g is taken out of the sums, so that gamma itself is never needed.
    """
    g = volume_gradients(x)
    x0, x1, x2, x3 = hourglass_modes(x)
    u0, u1, u2, u3 = hourglass_modes(u)
    spread = ebb.zeros(ebb.mat3d)
    for i in (0, 1, 2, 3, 4, 5, 6, 7):
        spread += ebb.outer(u[i], g[i] / zone_volume)
    h0, h1, h2, h3 = u0 - spread @ x0, u1 - spread @ x1, u2 - spread @ x2, u3 - spread @ x3
    turned = (ebb.outer(h0, x0) + ebb.outer(h1, x1) + ebb.outer(h2, x2) + ebb.outer(h3, x3)) / zone_volume
    a, b, c, d = h0 + h1, h0 - h1, h2 + h3, h2 - h3
    return (
        turned @ g[0] - a - d,
        turned @ g[1] - b + d,
        turned @ g[2] + a - d,
        turned @ g[3] + b + d,
        turned @ g[4] + a - c,
        turned @ g[5] + b + c,
        turned @ g[6] - a - c,
        turned @ g[7] - b + c,
    )


@ebb.kernel
def add_forces(z):
    x, u = corners(z, "pos"), corners(z, "vel")
    i, j, k = axes(x)
    assert ebb.dot(j, ebb.cross(k, i)) > 0 and z.vol > 0, "the zone has no volume left"
    assert z.q <= LARGEST_VISCOSITY, "the artificial viscosity is above its limit"
    zone_volume = z.initial_volume * z.vol
    viscosity = HOURGLASS * z.sound_speed * DENSITY * z.initial_volume / ebb.cbrt(zone_volume)
    h = hourglass_forces(x, u, zone_volume)
    f0, f1, f2, f3, f4, f5 = faces(x)
    stress = (z.p + z.q) / 8
    z.corner(0).force += stress * (f0 + f1 + f4) + viscosity * h[0]
    z.corner(1).force += stress * (f0 + f1 + f2) + viscosity * h[1]
    z.corner(2).force += stress * (f0 + f2 + f3) + viscosity * h[2]
    z.corner(3).force += stress * (f0 + f3 + f4) + viscosity * h[3]
    z.corner(4).force += stress * (f1 + f4 + f5) + viscosity * h[4]
    z.corner(5).force += stress * (f1 + f2 + f5) + viscosity * h[5]
    z.corner(6).force += stress * (f2 + f3 + f5) + viscosity * h[6]
    z.corner(7).force += stress * (f3 + f4 + f5) + viscosity * h[7]


# ---- Motion of nodes ----


def hold_in_plane(axis: int) -> ebb.Kernel:
    """Nodes in a plane of symmetry are not pushed out of it."""

    @ebb.kernel
    def hold(n):
        n.force[axis] = 0.0

    return hold


@ebb.kernel
def move_nodes(n):
    vel = n.vel + n.force * (dt.value / n.mass)
    vel = ebb.select(abs(vel) < VELOCITY_CUT, 0.0, vel)
    n.vel = vel
    n.pos += vel * dt.value
    n.force = [0, 0, 0]


# ---- Kinematics of zones ----


@ebb.kernel
def find_kinematics(z):
    x, u = corners(z, "pos"), corners(z, "vel")
    new_volume = volume(x)
    z.new_vol = new_volume / z.initial_volume
    assert new_volume > 0, "the zone has no volume left"
    largest = 0.0
    for normal in faces(x):
        largest = max(largest, ebb.dot(normal, normal))
    z.length = 2 * new_volume / ebb.sqrt(largest)  # the volume over the largest face

    i, j, k = axes(x)
    du, dv, dw = axes(u)
    jk, ki, ij = ebb.cross(j, k), ebb.cross(k, i), ebb.cross(i, j)
    # The gradient of the velocity, and the thickness of the zone, along each of its axes.
    scale = 1 / (new_volume + TINY)
    gradient = scale * [ebb.dot(du, jk), ebb.dot(dv, ki), ebb.dot(dw, ij)]
    dx = [thickness(new_volume, jk), thickness(new_volume, ki), thickness(new_volume, ij)]
    for axis in AXES:
        z[DU[axis]], z[DX[axis]] = gradient[axis], dx[axis]
    # The rate of expansion, d(ln V) / dt, at the centre in the middle of the step.
    half = 0.5 * dt.value
    i, j, k = i - half * du, j - half * dv, k - half * dw
    jk, ki, ij = ebb.cross(j, k), ebb.cross(k, i), ebb.cross(i, j)
    z.expansion = (ebb.dot(du, jk) + ebb.dot(dv, ki) + ebb.dot(dw, ij)) / ebb.dot(j, ki)


@ebb.func
def thickness(zone_volume, area):
    return zone_volume / ebb.sqrt(ebb.dot(area, area) + TINY)


# ---- Artificial viscosity ----


@ebb.func
def limiter(own, before, after):
    """1 where the velocity goes on evenly from zone to zone, so that there is no viscosity, and 0 in a shock."""
    before, after = before / (own + TINY), after / (own + TINY)
    return ebb.clamp(min(0.5 * (before + after), 2 * before, 2 * after), 0.0, 1.0)


@ebb.kernel
def find_viscosity(z):
    linear, quadratic = 0.0, 0.0
    for axis in AXES:
        own = z[DU[axis]]
        before, after = z.beyond(2 * axis)[DU[axis]], z.beyond(2 * axis + 1)[DU[axis]]
        if z.boundary(2 * axis + 1) == HexMesh.FREE:
            after = 0.0
        smooth = limiter(own, before, after)
        jump = min(own * z[DX[axis]], 0.0)
        linear += jump * (1 - smooth)
        quadratic += jump * jump * (1 - smooth * smooth)
    rho = ebb.select(z.expansion > 0, 0.0, DENSITY / z.new_vol)
    z.linear_q = -LINEAR * rho * linear
    z.quadratic_q = QUADRATIC * rho * quadratic


# ---- The equation of state ----


@ebb.func
def pressure(e, gas_per_volume):
    p = gas_per_volume * e
    return ebb.select(p < PRESSURE_CUT, 0.0, p)  # nor is any pressure below 0


@ebb.func
def speed_of_sound(e, p, v):
    square = e + p * v  # but for a factor
    sound = SLOWEST_SOUND
    if not square <= SLOWEST_SOUND * SLOWEST_SOUND * DENSITY / GAS:  # most gas is at rest and cold: roots take long
        sound = ebb.sqrt(GAS / DENSITY * square)
    return sound


@ebb.func
def held_energy(e):
    return max(ebb.select(abs(e) < ENERGY_CUT, 0.0, e), SMALLEST_ENERGY)


@ebb.func
def shock_viscosity(z, change, sound):
    return ebb.select(change > 0, 0.0, sound * z.linear_q + z.quadratic_q)  # none where the gas expands


@ebb.kernel
def evaluate_gas(z):
    """Energy, pressure and viscosity after the change of volume, by a predictor and two correctors.

    What is known last is added last, so that a processor that has several zones in hand waits for less.
    """
    v = ebb.clamp(z.new_vol, SMALLEST_VOLUME, LARGEST_VOLUME)
    change = z.new_vol - z.vol
    half_v = ebb.select(z.new_vol <= SMALLEST_VOLUME, v, v - 0.5 * change)
    thin = z.new_vol >= LARGEST_VOLUME
    gas_per_half, gas_per_v = GAS / half_v, ebb.select(thin, 0.0, GAS / v)
    old = ebb.select(thin, 0.0, z.p) + z.q

    e = max(z.e - 0.5 * change * old, SMALLEST_ENERGY)
    half_p = pressure(e, gas_per_half)
    half = half_p + shock_viscosity(z, change, speed_of_sound(e, half_p, half_v))
    e = held_energy(e + 1.5 * change * old - 2 * change * half)
    p = pressure(e, gas_per_v)
    q = shock_viscosity(z, change, speed_of_sound(e, p, v))
    e = held_energy(e - 1 / 6 * change * (7 * old - 8 * half + q) - 1 / 6 * change * p)
    p = pressure(e, gas_per_v)
    sound = speed_of_sound(e, p, v)
    q = shock_viscosity(z, change, sound)
    z.new_e = e
    z.new_p = p
    z.new_q = ebb.select(abs(q) < VISCOSITY_CUT, 0.0, q)
    z.sound_speed = sound


# ---- The time step ----


@ebb.kernel
def limit_step(z):
    """The time that sound and viscosity take through a zone, and the time in which its volume changes by a tenth."""
    viscous = COURANT_VISCOSITY * z.length * min(z.expansion, 0.0)
    crossing = z.length / ebb.sqrt(z.sound_speed * z.sound_speed + viscous * viscous)
    courant.value = min(courant.value, ebb.select(z.expansion != 0, crossing, HUGE))
    hydro.value = min(hydro.value, ebb.select(z.expansion != 0, LARGEST_CHANGE / (abs(z.expansion) + 1e-20), HUGE))
    z.vol = ebb.select(abs(z.new_vol - 1) < VOLUME_CUT, 1.0, z.new_vol)


@ebb.kernel
def next_step(c):
    if c.cycle > 0:
        step = HUGE
        if courant.value < step:
            step = courant.value / 2
        if hydro.value < step:
            step = hydro.value * 2 / 3
        growth = step / c.dt
        if growth >= 1 and growth < LEAST_GROWTH:
            step = c.dt
        elif growth > MOST_GROWTH:
            step = c.dt * MOST_GROWTH
        c.dt = min(step, LARGEST_STEP)
    left = STOP_TIME - c.time
    if left > c.dt and left < 4 * c.dt / 3:
        left = 2 * c.dt / 3  # so that the last step is not much shorter than those before it
    c.dt = min(c.dt, left)
    c.time += c.dt
    c.cycle += 1
    dt.value = min(dt.value, c.dt)


# ---- Start ----


@ebb.kernel
def start_zone(z):
    z.initial_volume = volume(corners(z, "pos"))
    for i in (0, 1, 2, 3, 4, 5, 6, 7):
        z.corner(i).mass += DENSITY * z.initial_volume / 8


# ---- The simulation ----


class DomainError(RuntimeError):
    """A zone that cannot go on: where, when and why."""


class Sedov:
    """The blast: ``run`` goes on with it.

    Attributes:
        mesh: a ``HexMesh`` or a ``HexGrid``.
        size: how many zones lie along a side.
        zones: the elements: energy ``e``, pressure ``p``, viscosity ``q``, volume ``vol`` in proportion to the first.
        nodes: the vertices: ``pos``, ``vel``, ``force``, ``mass``.
    """

    def __init__(self, size: int, regions: int = 1, balance: int = 1, cost: int = 1, mesh: str = "unstructured"):
        """The gas at rest, with all energy in the zone at the origin.

        Args:
            size: how many zones lie along a side.
            regions: how many, each of the same gas.
            balance: how much larger later regions are.
            cost: how much more often than once the gas of later regions is evaluated.
            mesh: ``unstructured`` or ``grid``.
        """
        self.size = size
        planes = ("xneg", "yneg", "zneg")
        self.mesh = MESHES[mesh].box(size, size, size, (SIDE,) * 3, symmetry=planes, precision=ebb.float64)
        self.zones, self.nodes = zones, nodes = self.mesh.elements, self.mesh.vertices
        for name in ("e", "p", "q", "new_e", "new_p", "new_q", "sound_speed", "linear_q", "quadratic_q"):
            zones.new_field(name, ebb.float64, init=0.0)
        for name in ("vol", "new_vol"):
            zones.new_field(name, ebb.float64, init=1.0)
        for name in ("initial_volume", "length", "expansion"):
            zones.new_field(name, ebb.float64)
        for name in ("vel", "force"):
            nodes.new_field(name, ebb.vec3d, init=0.0)
        nodes.new_field("mass", ebb.float64, init=0.0)
        start_zone(zones)
        energy = np.zeros(size**3)
        energy[0] = ORIGIN_ENERGY * size**3
        zones.e.load(energy.reshape(zones.shape))
        first = 0.5 * np.cbrt((SIDE / size) ** 3) / np.sqrt(2 * energy[0])
        self._clock = ebb.Relation("clock", size=1)
        for name, kind, start in (("time", ebb.float64, 0.0), ("dt", ebb.float64, first), ("cycle", ebb.int64, 0)):
            self._clock.new_field(name, kind, init=start)
        region_of = draw_regions(size**3, regions, balance)
        self._regions: list[tuple[Any, int]] = []
        for region in range(regions):
            rows = zones
            if regions > 1:
                mask = (region_of == region).reshape(zones.shape)
                rows = zones.new_subset(f"region_{region}", mask)
            self._regions.append((rows, evaluations(region, regions, cost)))
        self._holds = [(hold_in_plane(axis), getattr(nodes, plane)) for axis, plane in enumerate(planes)]
        with ebb.capture() as self._cycle:
            self._record()
        self._lasting: tuple[Any, ...] = ()

    def keep_whole(self) -> None:
        """See to it that after an error all is as it was after the last whole cycle, for the memory of that."""
        zones, nodes, clock = self.zones, self.nodes, self._clock
        state = zones.e, zones.p, zones.q, zones.vol, zones.sound_speed, nodes.pos, nodes.vel, nodes.force
        self._lasting = (*state, clock.time, clock.dt, clock.cycle, courant, hydro)

    def _record(self) -> None:
        """One cycle."""
        zones, nodes = self.zones, self.nodes
        dt.value = HUGE
        next_step(self._clock)
        courant.value = hydro.value = HUGE

        add_forces(zones)
        for hold, plane in self._holds:
            hold(plane)
        move_nodes(nodes)

        find_kinematics(zones)
        find_viscosity(zones)  # needs no gas, so regions would compute the same
        for rows, times in self._regions:
            for _ in range(times):
                evaluate_gas(rows)
        for name in ("e", "p", "q"):
            zones.swap(name, f"new_{name}")
        limit_step(zones)

    @property
    def cycle(self) -> int:
        """How many cycles have been made."""
        return int(self._clock.cycle.to_numpy()[0])

    @property
    def time(self) -> float:
        """How far they came."""
        return float(self._clock.time.to_numpy()[0])

    @property
    def dt(self) -> float:
        """The last time step."""
        return float(self._clock.dt.to_numpy()[0])

    def run(self, cycles: int, progress: Callable[[float], object] = lambda time: None) -> None:
        """Go on until the end of the problem, or for so many cycles more.

        Args:
            cycles: at most so many.
            progress: is told the time now and then.

        Raises:
            DomainError: a zone has no volume left, or too much artificial viscosity.
        """
        while cycles > 0 and self.time < STOP_TIME:
            batch = min(cycles, self._cycles_for_sure())
            try:
                run_whole(self._cycle, batch, self._lasting)
            except ebb.KernelAssertionError as error:
                # Where a whole cycle is kept, the state has been put back to the one before that which failed.
                raise DomainError(f"cycle {self.cycle + bool(self._lasting)}: {error}") from error
            cycles -= batch
            progress(self.time)

    def _cycles_for_sure(self) -> int:
        """So many cycles do not reach the end, whatever their time steps; but one is always made.

        Steps grow by 1.2 at most, so n of them take at most dt (1.2 + 1.2^2 + ... + 1.2^n).
        """
        left = (STOP_TIME - self.time) / self.dt
        count = np.log1p(left * (MOST_GROWTH - 1) / MOST_GROWTH) / np.log(MOST_GROWTH)
        return max(1, int(count) - 1)

    def symmetry(self) -> tuple[float, float, float]:
        """How much the energy in the plane at the origin differs from its mirror image.

        The largest difference, the sum of all, and the largest in proportion to the energy.
        """
        plane = self.zones.e.to_numpy().reshape((self.size,) * 3)[0]
        upper = np.triu_indices(self.size, 1)
        difference = np.abs(plane - plane.T)[upper]
        if not difference.size:
            return 0.0, 0.0, 0.0
        with np.errstate(all="ignore"):
            relative = np.nan_to_num(difference / plane.T[upper], nan=0.0)
        return float(difference.max()), float(difference.sum()), float(relative.max())

    def origin_energy(self) -> float:
        """The energy of the zone at the origin."""
        return float(self.zones.e.to_numpy().flat[0])


# ---- The program ----


def moment(blast: Sedov) -> Moment:
    """The state now, for a picture."""
    from sedov_picture import Moment

    n = blast.size
    x, v = blast.nodes.pos.to_numpy(), blast.zones.vol.to_numpy()
    return Moment(x.reshape(n + 1, n + 1, n + 1, 3), DENSITY / v.reshape(n, n, n))


def dump(path: Path, blast: Sedov) -> None:
    """Write the state in the numbering of the reference, whose first axis goes fastest.

    Here the last axis does; since nothing changes when axes are exchanged, rows stay, and x and z change places.
    """
    zones, nodes = blast.zones, blast.nodes
    pos, vel = moment(blast).x.reshape(-1, 3), nodes.vel.to_numpy().reshape(-1, 3)
    names = {"e": "e", "p": "p", "q": "q", "v": "vol", "ss": "sound_speed"}
    save_arrays(
        path,
        time=blast.time,
        dt=blast.dt,
        cycle=blast.cycle,
        **{name: zones.fields[field].to_numpy().ravel() for name, field in names.items()},
        **{name: pos[:, 2 - axis] for axis, name in enumerate("xyz")},
        **{f"{name}d": vel[:, 2 - axis] for axis, name in enumerate("xyz")},
    )


def summary(blast: Sedov, elapsed: float) -> str:
    """What the reference says at the end."""
    largest, total, relative = blast.symmetry()
    grind = elapsed * 1e6 / max(blast.cycle, 1) / blast.size**3
    return "\n".join(
        [
            "Run completed:",
            f"   Problem size        =  {blast.size}",
            f"   Iteration count     =  {blast.cycle}",
            f"   Final Origin Energy =  {blast.origin_energy():.6e}",
            "   Testing Plane 0 of Energy Array:",
            f"        MaxAbsDiff   = {largest:.6e}",
            f"        TotalAbsDiff = {total:.6e}",
            f"        MaxRelDiff   = {relative:.6e}",
            "",
            f"Elapsed time         = {elapsed:10.2f} (s)",
            f"Grind time (us/z/c)  = {grind:10.6g}",
            f"FOM                  = {1000 / grind if grind else 0.0:10.6g} (z/s)",
        ]
    )


def refuse_bad_input(size: int, regions: int, balance: int, mesh: str, dump: Path | None, save: Path | None) -> None:
    """Say at once what would fail in the end."""
    if mesh not in MESHES:
        raise typer.BadParameter(f"--mesh is one of {', '.join(MESHES)}, not {mesh}")
    if regions > size**3:
        raise typer.BadParameter(f"--regions {regions} is more than the {size**3} zones of --size {size}")
    weights = [(region + 1) ** balance for region in range(regions)] if regions <= size**3 and balance < 32 else []
    if regions > 1 and not (sum(weights) < min(2**31, 1e5 * sum(weights[:-1]))):
        raise typer.BadParameter(f"--balance {balance} leaves next to nothing to smaller regions")
    check_output("--dump", dump, ".npz")
    check_output("--save", save, ".vtk", ".png", "")
    for suffix in (".vtk", ".png"):
        check_output("--save", None if save is None else save.with_suffix(suffix), suffix)


def main(
    size: Annotated[int, typer.Option(help="zones along a side", min=1)] = 30,
    iterations: Annotated[int, typer.Option(help="cycles, at most", min=1)] = 9_999_999,
    regions: Annotated[int, typer.Option(help="how many", min=1)] = 11,
    balance: Annotated[int, typer.Option(help="how much larger later regions are", min=0)] = 1,
    cost: Annotated[int, typer.Option(help="how much more work later regions are", min=0)] = 1,
    mesh: Annotated[str, typer.Option(help="unstructured or grid")] = "unstructured",
    backend: Backend = "cpu",
    threads: Threads = None,
    dump_to: Annotated[Path | None, typer.Option("--dump", help="the last state as NumPy arrays (.npz)")] = None,
    save: Annotated[
        Path | None, typer.Option(help="the last state for VTK (.vtk) and a picture beside it (.png)")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="no progress, and no summary")] = False,
) -> None:
    """Run the Sedov blast of LULESH."""
    console = Console(highlight=False, quiet=quiet)
    refuse_bad_input(size, regions, balance, mesh, dump_to, save)
    if threads is not None and threads > (os.cpu_count() or 1):
        console.print(f"{threads} threads on a machine with {os.cpu_count()} cores will be slow", style="yellow")
    blast: Sedov | None = None
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        started = time.perf_counter()
        blast = Sedov(size, regions, balance, cost, mesh)
        console.print(f"{size}^3 zones in {regions} region{'s' * (regions > 1)}, mesh {mesh}, backend {backend}")
        if dump_to is not None:
            blast.keep_whole()
        console.print(f"made ready in {time.perf_counter() - started:.2f} s")
        elapsed, moments = watch(blast, iterations, save is not None, console)
        console.print(summary(blast, elapsed))
        if save is not None:
            zone_fields = [blast.zones.fields[name] for name in ("e", "p", "q", "vol")]
            blast.mesh.save(save.with_suffix(".vtk"), fields=[blast.nodes.vel, *zone_fields])
            from pictures import save_strip
            from sedov_picture import skin

            drawn = save_strip(save.with_suffix(".png"), [skin(shown) for shown in moments], elevation=32)
            console.print(f"drawn by {drawn}", markup=False)
            console.print(f"saved {save.with_suffix('.vtk')} and {save.with_suffix('.png')}")
    except (ebb.EbbError, DomainError) as error:
        raise SystemExit(str(error)) from None
    finally:
        if dump_to is not None and blast is not None:
            dump(dump_to, blast)
            console.print(f"dumped cycle {blast.cycle} to {dump_to}")


def watch(blast: Sedov, iterations: int, pictures: bool, console: Console) -> tuple[float, list[Moment]]:
    """Run to the end; the seconds that it took, and moments at which the shock had come equally further each time.

    Its radius grows with the time to the power of 2/5 (Sedov).
    """
    moments, due = [], [STOP_TIME * (k / 4) ** 2.5 for k in (1, 2, 3)] if pictures else []
    columns = (TextColumn("time {task.completed:.6f}"), BarColumn(), TextColumn("cycle {task.fields[cycle]}"))
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task("", total=STOP_TIME, cycle=0)

        def progress(now: float) -> None:
            shown.update(task, completed=now, cycle=blast.cycle)
            if due and now >= due[0]:
                due.pop(0)
                moments.append(moment(blast))

        started = time.perf_counter()
        blast.run(iterations, progress)
        elapsed = time.perf_counter() - started
    return elapsed, [*moments, moment(blast)] if pictures else []


if __name__ == "__main__":
    typer.run(main)
