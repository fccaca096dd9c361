"""Whole programs of the kind that Ebb is for, against NumPy and closed forms."""

from __future__ import annotations

import numpy as np

import ebb
from ebb.domains import TetMesh, TriMesh

from .harness import grid, offset_member


def test_game_of_life(backend):
    cells = ebb.Relation("cells", shape=(8, 10), periodic=(True, True))
    start = np.random.default_rng(0).integers(0, 2, (8, 10)).astype(bool)
    cells.new_field("alive", ebb.bool_, init=start)
    cells.new_field("next", ebb.bool_)
    offset_member(cells)
    neighbours = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))

    @ebb.kernel
    def live(c: cells):
        n = 0
        for i, j in neighbours:
            n += 1 if c(i, j).alive else 0
        c.next = n == 3 or (c.alive and n == 2)

    expected = start
    for _ in range(5):
        live(cells)
        cells.swap("alive", "next")
        n = sum(np.roll(expected, shift, (0, 1)).astype(int) for shift in neighbours)
        expected = (n == 3) | (expected & (n == 2))
    np.testing.assert_array_equal(cells.alive.to_numpy(), expected)


def test_jacobi_for_poisson(backend):
    """A discrete sine is an eigenvector of the iteration, so each sweep shrinks it by a known factor."""
    n, sweeps = 9, 12
    cells = grid((n + 1, n + 1))
    i, j = np.indices((n + 1, n + 1)) * np.pi / n
    start = np.sin(i) * np.sin(2 * j)
    cells.x.load(start)
    cells.y.load(start)
    cells.new_subset("interior", np.s_[1:-1, 1:-1])

    @ebb.kernel
    def relax(c: cells):
        c.y = 0.25 * (c(1, 0).x + c(-1, 0).x + c(0, 1).x + c(0, -1).x)

    for _ in range(sweeps):
        relax(cells.interior)
        cells.swap("x", "y")
    factor = (np.cos(np.pi / n) + np.cos(2 * np.pi / n)) / 2
    np.testing.assert_allclose(cells.x.to_numpy(), start * factor**sweeps, atol=1e-12)


def test_the_wave_equation_conserves_its_energy(backend):
    n, dt = 32, 0.1
    line = ebb.Relation("line", shape=(n,), periodic=(True,))
    line.new_field("u", ebb.float64, init=lambda i: np.sin(2 * np.pi * i / n))
    line.new_field("v", ebb.float64, init=0.0)
    energy = ebb.Global(ebb.float64, 0.0)
    offset_member(line)

    @ebb.kernel
    def kick(c: line):
        c.v += dt * (c(1).u - 2 * c.u + c(-1).u)

    @ebb.kernel
    def drift(c: line):
        c.u += dt * c.v

    @ebb.kernel
    def measure(c: line):
        gradient = c(1).u - c.u
        energy.value += 0.5 * (c.v * c.v + gradient * gradient)

    measure(line)
    first = energy.value
    for _ in range(50):
        kick(line)
        drift(line)
    energy.value = 0
    measure(line)
    assert abs(energy.value / first - 1) < 0.02
    omega = 2 * np.sin(np.pi / n)
    amplitude = np.abs(np.fft.fft(line.u.to_numpy())[1]) * 2 / n
    np.testing.assert_allclose(amplitude, abs(np.cos(2 * np.arcsin(omega * dt / 2) * 50)), atol=0.02)


def test_finite_volumes_conserve_mass(backend):
    cells = ebb.Relation("cells", shape=(20,))
    faces = ebb.Relation("faces", shape=(21,))
    cells.new_field("rho", ebb.float64, init=lambda i: 1.0 + (i == 3))
    faces.new_field("flux", ebb.float64, init=0.0)
    faces.new_subset("inner", np.s_[1:-1])
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def upwind(f: faces):
        f.flux = 0.4 * ebb.affine(cells, [[1, -1]], f).rho

    @ebb.kernel
    def update(c: cells):
        c.rho += ebb.affine(faces, [[1, 0]], c).flux - ebb.affine(faces, [[1, 1]], c).flux

    @ebb.kernel
    def weigh(c: cells):
        total.value += c.rho

    expected = cells.rho.to_numpy()
    for _ in range(7):
        upwind(faces.inner)
        update(cells)
        flux = np.concatenate([[0], 0.4 * expected[:-1], [0]])
        expected = expected + flux[:-1] - flux[1:]
    weigh(cells)
    np.testing.assert_allclose(cells.rho.to_numpy(), expected, atol=1e-13)
    np.testing.assert_allclose(total.value, 21)


def test_particles_to_grid_and_back(backend):
    """Bilinear weights: what is deposited sums to what the particles have, and linear fields are gathered exactly."""
    nodes = ebb.Relation("nodes", shape=(6, 7))
    nodes.new_field("mass", ebb.float64, init=0.0)
    nodes.new_field("height", ebb.float64, init=lambda i, j: 2.0 * i - 3.0 * j + 1)
    generator = np.random.default_rng(4)
    pos = generator.uniform(0, (4.999, 5.999), (40, 2))
    particles = ebb.Relation("particles", size=40)
    particles.new_field("pos", ebb.vec2d, init=pos)
    particles.new_field("node", nodes, init=pos.astype(int))
    particles.new_field("height", ebb.float64, init=0.0)
    offset_member(nodes)

    @ebb.func
    def weight(p, i, j):
        t = p.pos - ebb.vec2d(ebb.coords(p.node))
        return (t.x if i == 1 else 1 - t.x) * (t.y if j == 1 else 1 - t.y)

    @ebb.kernel
    def deposit(p: particles):
        for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
            p.node(i, j).mass += 2.0 * weight(p, i, j)

    @ebb.kernel
    def gather(p: particles):
        for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
            p.height += weight(p, i, j) * p.node(i, j).height

    deposit(particles)
    gather(particles)
    mass = nodes.mass.to_numpy()
    np.testing.assert_allclose(mass.sum(), 80)
    np.testing.assert_allclose(np.einsum("ij,i->", mass, np.arange(6)), 2 * pos[:, 0].sum())
    np.testing.assert_allclose(particles.height.to_numpy(), pos @ [2, -3] + 1)


def test_connected_components_by_label_propagation(backend):
    count = 30
    ends = np.random.default_rng(9).integers(0, count, (22, 2))
    vertices, edges = ebb.Relation("vertices", size=count), ebb.Relation("edges", size=len(ends))
    vertices.new_field("label", ebb.int64, init=np.arange(count))
    vertices.new_field("next", ebb.int64, init=np.arange(count))
    edges.new_field("a", vertices, init=ends[:, 0])
    edges.new_field("b", vertices, init=ends[:, 1])
    changed = ebb.Global(ebb.bool_, True)

    @ebb.kernel
    def spread(e: edges):
        low = min(e.a.label, e.b.label)
        e.a.next = min(e.a.next, low)
        e.b.next = min(e.b.next, low)

    @ebb.kernel
    def accept(v: vertices):
        changed.value |= v.next < v.label
        v.label = v.next

    while changed.value:
        changed.value = False
        spread(edges)
        accept(vertices)
    expected = np.arange(count)
    for _ in range(count):
        for a, b in ends:
            expected[[a, b]] = expected[[a, b]].min()
    np.testing.assert_array_equal(vertices.label.to_numpy(), expected)


def test_page_rank(backend):
    count = 12
    links = np.random.default_rng(2).integers(0, count, (50, 2))
    pages, hrefs = ebb.Relation("pages", size=count), ebb.Relation("hrefs", size=50)
    pages.new_field("rank", ebb.float64, init=1 / count)
    pages.new_field("inflow", ebb.float64, init=0.0)
    pages.new_field("degree", ebb.int32, init=0)
    hrefs.new_field("source", pages, init=links[:, 0])
    hrefs.new_field("target", pages, init=links[:, 1])
    hrefs.group_by("target")
    damping = 0.85

    @ebb.kernel
    def count_links(h: hrefs):
        h.source.degree += 1

    @ebb.kernel
    def collect(p: pages):
        p.inflow = 0
        for source in ebb.where(hrefs.target, p).source:
            p.inflow += source.rank / source.degree

    @ebb.kernel
    def update(p: pages):
        p.rank = (1 - damping) / pages.size + damping * p.inflow

    count_links(hrefs)
    matrix = np.zeros((count, count))
    np.add.at(matrix, (links[:, 1], links[:, 0]), 1)
    degree = np.maximum(matrix.sum(axis=0), 1)
    expected = np.full(count, 1 / count)
    for _ in range(10):
        collect(pages)
        update(pages)
        expected = 0.15 / count + 0.85 * (matrix / degree) @ expected
    np.testing.assert_allclose(pages.rank.to_numpy(), expected)


def test_area_volume_and_normals_of_a_sphere(backend):
    mesh = TriMesh.icosphere(2)
    triangles, vertices = mesh.triangles, mesh.vertices
    vertices.new_field("normal", ebb.vec3d, init=0.0)
    vertices.new_field("valence", ebb.int32, init=0)
    area, volume, euler = ebb.Global(ebb.float64, 0), ebb.Global(ebb.float64, 0), ebb.Global(ebb.int32, 0)

    @ebb.kernel
    def integrate(t: triangles):
        a, b, c = ebb.vec3d(t.v[0].pos), ebb.vec3d(t.v[1].pos), ebb.vec3d(t.v[2].pos)
        n = ebb.cross(b - a, c - a)
        area.value += 0.5 * ebb.length(n)
        volume.value += ebb.dot(a, n) / 6
        euler.value += 1
        for i in range(3):
            t.v[i].normal += n

    @ebb.kernel
    def count(v: vertices):
        euler.value += 1
        for _ in v.edges:
            v.valence += 1

    integrate(triangles)
    count(vertices)
    points, cells = vertices.pos.to_numpy().astype(float), triangles.v.to_numpy()
    corners = points[cells]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(area.value, np.linalg.norm(normals, axis=1).sum() / 2)
    np.testing.assert_allclose(volume.value, np.einsum("ni,ni->", corners[:, 0], normals) / 6)
    assert euler.value - vertices.valence.to_numpy().sum() // 2 == 2
    radial = vertices.normal.to_numpy()
    np.testing.assert_allclose((radial * points).sum(1), np.linalg.norm(radial, axis=1), rtol=1e-2)


def test_linear_finite_elements_reproduce_linear_functions(backend):
    """The gradient of a linear function on tetrahedra, and its energy, are exact."""
    mesh = TetMesh.box(2, 2, 2)
    tets, vertices = mesh.tetrahedra, mesh.vertices
    vertices.new_field("u", ebb.float64, init=vertices.pos.to_numpy() @ [1.0, -2.0, 3.0])
    tets.new_field("gradient", ebb.vec3d)
    energy = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def differentiate(t: tets):
        origin = ebb.vec3d(t.v[0].pos)
        D = ebb.zeros(ebb.mat3d)
        du = ebb.zeros(ebb.vec3d)
        for i in range(3):
            D[i] = ebb.vec3d(t.v[i + 1].pos) - origin
            du[i] = t.v[i + 1].u - t.v[0].u
        t.gradient = ebb.inverse(D) @ du
        energy.value += 0.5 * ebb.dot(t.gradient, t.gradient) * ebb.det(D) / 6

    differentiate(tets)
    np.testing.assert_allclose(tets.gradient.to_numpy(), np.tile([1, -2, 3], (tets.size, 1)), rtol=1e-6)
    np.testing.assert_allclose(energy.value, 7, rtol=1e-6)


def test_a_chain_keeps_its_length(backend):
    """Position-based dynamics of a chain that is pinned at one end."""
    points, sticks = ebb.Relation("points", size=5), ebb.Relation("sticks", size=4)
    points.new_field("x", ebb.vec2d, init=lambda i: [float(i), 0.0])
    points.new_field("correction", ebb.vec2d, init=0.0)
    points.new_field("v", ebb.vec2d, init=0.0)
    points.new_field("pinned", ebb.bool_, init=[True, False, False, False, False])
    sticks.new_field("a", points, init=[0, 1, 2, 3])
    sticks.new_field("b", points, init=[1, 2, 3, 4])
    g, dt = np.array([0.0, -10.0]), 0.01

    @ebb.kernel
    def integrate(p: points):
        if not p.pinned:
            p.v += dt * g
            p.x += dt * p.v

    @ebb.kernel
    def project(s: sticks):
        d = s.b.x - s.a.x
        shift = 0.25 * (1 - 1 / ebb.length(d)) * d
        s.a.correction += shift
        s.b.correction -= shift

    @ebb.kernel
    def apply(p: points):
        if not p.pinned:
            p.x += p.correction
            p.v += p.correction / dt
        p.correction = [0, 0]

    for _ in range(10):
        integrate(points)
        for _ in range(40):
            project(sticks)
            apply(points)
    x = points.x.to_numpy()
    np.testing.assert_allclose(np.linalg.norm(np.diff(x, axis=0), axis=1), 1, atol=2e-2)
    np.testing.assert_array_equal(x[0], [0, 0])
    np.testing.assert_allclose(x[-1], [4, -10 * dt * dt * 55], atol=1e-2)


def test_sobel_filter_with_clamped_edges(backend):
    image = ebb.Relation("image", shape=(6, 8))
    pixels = np.random.default_rng(1).random((6, 8))
    image.new_field("p", ebb.float32, init=pixels)
    image.new_field("edge", ebb.float32)
    kernel_x = ((-1, 0, 1), (-2, 0, 2), (-1, 0, 1))

    @ebb.kernel
    def sobel(c: image):
        gx = ebb.float32(0)
        gy = ebb.float32(0)
        for i in (0, 1, 2):
            for j in (0, 1, 2):
                p = ebb.affine(image, [[1, 0, i - 1], [0, 1, j - 1]], c, edge="clamp").p
                gx += kernel_x[i][j] * p
                gy += kernel_x[j][i] * p
        c.edge = ebb.sqrt(gx * gx + gy * gy)

    sobel(image)
    padded = np.pad(pixels.astype(np.float32), 1, mode="edge").astype(float)
    window = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    gx, gy = (np.einsum("ijkl,kl->ij", window, k) for k in (np.array(kernel_x), np.array(kernel_x).T))
    np.testing.assert_allclose(image.edge.to_numpy(), np.hypot(gx, gy), rtol=1e-4, atol=1e-5)


def test_k_means(backend):
    generator = np.random.default_rng(3)
    data = np.concatenate([generator.normal(centre, 0.1, (20, 2)) for centre in ((0, 0), (3, 1), (-2, 4))])
    points, means = ebb.Relation("points", size=60), ebb.Relation("means", size=3)
    points.new_field("x", ebb.vec2d, init=data)
    points.new_field("mean", means, init=np.arange(60) % 3)
    points.new_field("best", ebb.float64)
    means.new_field("x", ebb.vec2d, init=data[[0, 20, 40]])
    means.new_field("total", ebb.vec2d)
    means.new_field("count", ebb.int32)
    candidates = ebb.Relation("candidates", size=180)
    candidates.new_field("point", points, init=np.repeat(np.arange(60), 3))
    candidates.new_field("mean", means, init=np.tile(np.arange(3), 60))
    candidates.group_by("point")

    @ebb.kernel
    def assign(p: points):
        p.best = 1e30
        for c in ebb.where(candidates.point, p):
            d = ebb.length(p.x - c.mean.x)
            if d < p.best:
                p.best = d
                p.mean = c.mean

    @ebb.kernel
    def clear(m: means):
        m.total = [0, 0]
        m.count = 0

    @ebb.kernel
    def accumulate(p: points):
        p.mean.total += p.x
        p.mean.count += 1

    @ebb.kernel
    def move(m: means):
        if m.count > 0:
            m.x = m.total / m.count

    for _ in range(3):
        assign(points)
        clear(means)
        accumulate(points)
        move(means)
    np.testing.assert_array_equal(points.mean.to_numpy(), np.repeat([0, 1, 2], 20))
    np.testing.assert_allclose(means.x.to_numpy(), data.reshape(3, 20, 2).mean(axis=1))
