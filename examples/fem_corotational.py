"""A soft body of corotational linear elasticity, by finite elements and implicit steps.

Hooke's law, in a frame that turns with each tetrahedron: with the polar decomposition F = R S, the energy is
mu |F - R|^2 + lam / 2 (tr S - 3)^2 (Sifakis and Barbic, SIGGRAPH 2012 course notes, chapter 3), and the stiffness its
second derivative, with what the turning of R adds to it (McAdams et al., "Efficient elasticity for character skinning
with contact and collisions", 2011, DOI 10.1145/1964921.1964932). R is a rotation also where a tetrahedron has turned
over, which then finds back.

    python examples/fem_corotational.py --save out/bar.png
"""

from __future__ import annotations

import typer

import ebb
import fem
import fem_program


@ebb.func
def rotation(f):
    """The rotation R that maximises tr R^T F, and the maximum, tr S.

    The maximum is the largest root x of x^4 - 2 p x^2 - 8 J x + 2 q - p^2, where p = tr C, q = tr C^2, C = F^T F and
    J = det F, and R its gradient with respect to F (Lin, Chitalu and Komura, "Isotropic ARAP energy using Cauchy-Green
    invariants", 2022, DOI 10.1145/3550454.3555507). Newton's iteration comes down to it from sqrt(3 p).
    """
    c = f.T @ f
    p, q, volume = ebb.trace(c), ebb.trace(c @ c), ebb.det(f)
    x = ebb.sqrt(3 * p)
    for _ in range(60):
        slope = 4 * x * (x * x - p) - 8 * volume
        value = ((x * x - 2 * p) * x - 8 * volume) * x + 2 * q - p * p
        lower = x - value / slope
        if not lower < x:
            break
        x = lower
    scale = max(x * (x * x - p) - 2 * volume, 1e-300)
    return ((x * x + p) * f + 2 * x * cofactors(f) - 2 * (f @ c)) / scale, x


@ebb.func
def hinge(f, r, stretch):
    """How R turns as F changes by dF: by the angles H w, where w is twice the axis of the skew part of dF R^T."""
    spin = stretch * ebb.identity(3) - f @ r.T
    # Where two stretches cancel each other, R may jump: there its turning counts for nothing.
    return ebb.inverse(spin) if ebb.det(spin) > 1e-9 * stretch * stretch * stretch else ebb.zeros((3, 3))


@ebb.func
def cofactors(f):
    """The cofactors of a matrix: det F times F^-T, also where that is 0."""
    x, y, z = ebb.cross(f[1], f[2]), ebb.cross(f[2], f[0]), ebb.cross(f[0], f[1])
    return [[x.x, x.y, x.z], [y.x, y.y, y.z], [z.x, z.y, z.z]]


@ebb.func
def skew(a):
    """The matrix whose product with b is the cross product of a and b."""
    return [[0.0, -a.z, a.y], [a.z, 0.0, -a.x], [-a.y, a.x, 0.0]]


@ebb.kernel
def assemble(t, scale: ebb.float64):
    f, g, mu, lam = fem.deformation(t), fem.shape_gradients(t), t.material.mu, t.material.lam
    r, stretch = rotation(f)
    tension = lam * (stretch - 3) - 2 * mu
    h = tension * hinge(f, r, stretch)
    if tension < 0 and ebb.det(f) < 0:
        # What has turned over is past its buckling: with so much of the turning, the stiffness is still positive.
        h *= min(1.0, -mu / (ebb.trace(h) - 1e-300))
    for i in range(4):
        a, turned = f @ g[i], r @ g[i]
        t.v[i].force += t.volume * (2 * mu * a + tension * turned)  # P g_i
        turning = skew(turned) @ h
        for j in range(4):
            b = r @ g[j]
            block = lam * ebb.outer(turned, b) - turning @ skew(b)
            for d in (0, 1, 2):
                block[d, d] += 2 * mu * ebb.dot(g[i], g[j])
            t.e[i, j].A += scale * t.volume * block


@ebb.kernel
def energy(t):
    f, mu, lam = fem.deformation(t), t.material.mu, t.material.lam
    r, stretch = rotation(f)
    strain = f - r
    square = ebb.trace(strain.T @ strain)
    fem.elastic.value += t.volume * (mu * square + 0.5 * lam * (stretch - 3) * (stretch - 3))


LAW = fem.Law("corotational", assemble, energy, bears_inversion=True)
main = fem_program.program(LAW)


if __name__ == "__main__":
    typer.run(main)
