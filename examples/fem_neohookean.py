"""A soft body of compressible neo-Hookean material, by finite elements and implicit steps.

The energy is mu / 2 (tr F^T F - 3) - mu log J + lam / 2 (log J)^2 with J = det F (Bonet and Wood, "Nonlinear Continuum
Mechanics for Finite Element Analysis", 2nd edition, 2008, section 6.4.3; Sifakis and Barbic, SIGGRAPH 2012 course
notes, chapter 3). It grows without bound as a tetrahedron is squashed to nothing, so none turns over.

    python examples/fem_neohookean.py --save out/bar.png
"""

from __future__ import annotations

import typer

import ebb
import fem
import fem_program


@ebb.kernel
def assemble(t, scale: ebb.float64):
    f, g, mu, lam = fem.deformation(t), fem.shape_gradients(t), t.material.mu, t.material.lam
    inverse = ebb.inverse(f).T
    pressure = lam * ebb.log(ebb.det(f))
    for i in range(4):
        # In space, the gradient of the shape function is F^-T g.
        a, c = f @ g[i], inverse @ g[i]
        t.v[i].force += t.volume * (mu * (a - c) + pressure * c)  # P g_i
        for j in range(4):
            d = inverse @ g[j]
            block = lam * ebb.outer(c, d) + (mu - pressure) * ebb.outer(d, c)
            for k in (0, 1, 2):
                block[k, k] += mu * ebb.dot(g[i], g[j])
            t.e[i, j].A += scale * t.volume * block


@ebb.kernel
def energy(t):
    f, mu, lam = fem.deformation(t), t.material.mu, t.material.lam
    log_j = ebb.log(ebb.det(f))
    stretch = ebb.trace(f.T @ f) - 3
    fem.elastic.value += t.volume * (0.5 * mu * stretch - mu * log_j + 0.5 * lam * log_j * log_j)


LAW = fem.Law("neo-Hookean", assemble, energy, bears_inversion=False)
main = fem_program.program(LAW)


if __name__ == "__main__":
    typer.run(main)
