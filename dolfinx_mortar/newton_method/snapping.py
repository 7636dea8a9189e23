# SPDX-License-Identifier: MIT
"""Has a step passed a limit point of its loads? Then the balance found is one beyond it.

At the start u_0 bodies are in a stable balance with the loads f_0, so that J(u) = Psi(u) - f_0.u is
smallest there, nearby. If the state at the end has less of it, an energy barrier has been passed,
or has vanished: an arch has snapped through. With the loads of the step, f, this is

    Psi(u) - f.u < Psi(u_0) - f.u_0 - r_0.(u - u_0),    r_0 = f - f_0 the first residual.
"""

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.terms.sum import Energy

# Share of the work of the change of loads by which energies have to differ: of a linear body it is
# the opposite of a half.
LEAST_DROP = 0.01


def notes_on_snapping(
    problem: ContactProblem, start: Floats, residual: PETSc.Vec, before: Energy
) -> list[str]:
    """Return a note if the bodies have snapped through in a step; collective.

    For a step in which supports rest and nothing is in contact, of loads with a potential.

    Args:
        problem: the problem at the end of the step.
        start: owned displacements (n,) at its start.
        residual: (n,) external less internal forces there, under the loads of the step.
        before: the energy there.
    """
    after = problem.terms.energy()
    assert after is not None  # as before
    work = problem.comm.allreduce(float(residual.array_r @ (problem.owned_u - start)))
    drop = before.value - work - after.value
    if not drop > max(LEAST_DROP * abs(work), 1e3 * np.finfo(float).eps * after.terms):
        return []
    return [
        "the bodies have snapped through: under the loads from which the step has started they "
        f"have less energy at its end, by {drop:.3g}, so the loads have passed a limit point on "
        "the way, and the balance found is one beyond it. Prescribe displacements instead to "
        "follow the way there"
    ]
