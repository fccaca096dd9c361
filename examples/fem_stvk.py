"""A soft body of St. Venant-Kirchhoff's material, by finite elements and implicit steps.

The energy is quadratic in the Green strain E = (F^T F - I) / 2, so the body may turn as it likes (Bonet and Wood,
"Nonlinear Continuum Mechanics for Finite Element Analysis", 2nd edition, 2008, chapter 6; Bernstein et al. 2015 measure
Vega FEM's). Where it is squashed to less than 0.58 of its length it gives way: see fem_neohookean.py.

    python examples/fem_stvk.py --save out/bar.png
    python examples/fem_stvk.py --mesh turtle.veg --fixed y- --save out/turtle.pvd
"""

from __future__ import annotations

import typer

import ebb
import fem
import fem_program


@ebb.kernel
def assemble(t, scale: ebb.float64):
    f, g, mu, lam = fem.deformation(t), fem.shape_gradients(t), t.material.mu, t.material.lam
    strain = 0.5 * (f.T @ f - ebb.identity(3))
    stress = lam * ebb.trace(strain) * ebb.identity(3) + 2 * mu * strain  # the second Piola-Kirchhoff stress S
    left = mu * (f @ f.T)
    for i in range(4):
        a, s = f @ g[i], stress @ g[i]
        t.v[i].force += t.volume * (f @ s)  # P g_i, where P = F S
        for j in range(4):
            # dP g_i where corner j moves by d: dF = d outer g_j in dP = dF S + F dS.
            b = f @ g[j]
            block = lam * ebb.outer(a, b) + mu * ebb.outer(b, a) + ebb.dot(g[i], g[j]) * left
            for d in (0, 1, 2):
                block[d, d] += ebb.dot(s, g[j])
            t.e[i, j].A += scale * t.volume * block


@ebb.kernel
def energy(t):
    f, mu, lam = fem.deformation(t), t.material.mu, t.material.lam
    strain = 0.5 * (f.T @ f - ebb.identity(3))
    trace = ebb.trace(strain)
    fem.elastic.value += t.volume * (0.5 * lam * trace * trace + mu * ebb.trace(strain @ strain))


LAW = fem.Law("St. Venant-Kirchhoff", assemble, energy, bears_inversion=True)
main = fem_program.program(LAW)


if __name__ == "__main__":
    typer.run(main)
