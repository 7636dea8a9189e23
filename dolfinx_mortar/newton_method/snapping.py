# SPDX-License-Identifier: MIT
"""Whether a step has passed a limit point of its loads, to an equilibrium beyond it.

At the start u_0 bodies are in a stable equilibrium under the loads f_0: J(u) = Psi(u) - f_0.u has a
local minimum there. If J is smaller at the end, the step has passed an energy barrier, or the
barrier has vanished: an arch has snapped through. With the loads of the step, f, this is

    Psi(u) - f.u < Psi(u_0) - f.u_0 - r_0.(u - u_0),    r_0 = f - f_0 the first residual.

A large step may lead to a state that had more energy under f_0. Then bodies without memory have
moved much further than K(u_0)^-1 r_0, which few of them do otherwise.
"""

from petsc4py import PETSc

from dolfinx_mortar.algebra.parallel import norm
from dolfinx_mortar.arrays import EPS, Floats
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.terms.sum import Energy

# How often the first step of Newton's method. Measured: 1.1 to 3.1 for a neo-Hookean bar pulled by
# 0.1 to 5 E, 0.03 to 0.5 for beams that bend far; 1.1 to 1.8 for a shallow arch below its limit
# load, 8.4 to 4.7 up to twice that load; 2 blames the bar, 8 misses most arches. Beyond 2.5 times
# the limit load, in one step, the arch has 3.8 and less and is not seen.
FURTHER = 4.0


def notes_on_snapping(
    problem: ContactProblem,
    start: Floats,
    residual: PETSc.Vec,
    before: Energy,
    expected: float,
) -> list[str]:
    """Return a note if the bodies have snapped through in a step; collective.

    For a step in which supports rest and nothing is in contact, of loads with a potential.

    Args:
        problem: the problem at the end of the step.
        start: owned displacements (n,) at its start.
        residual: (n,) external less internal forces there, under the loads of the step.
        before: the energy there.
        expected: norm of the first step of Newton's method, NaN if the tangent was another.
    """
    after = problem.terms.energy()
    assert after is not None  # as before
    work = problem.comm.allreduce(float(residual.array_r @ (problem.owned_u - start)))
    drop = before.value - work - after.value
    if not drop > 1e3 * EPS * after.terms:
        return _note_on_motion(problem, start, expected)
    return [
        "the bodies have snapped through: under the loads from which the step has started they "
        f"have less energy at its end, by {drop:.3g}, so the loads have passed a limit point on "
        "the way, and the equilibrium found is one beyond it. Prescribe displacements instead to "
        "follow the way there"
    ]


def _note_on_motion(problem: ContactProblem, start: Floats, expected: float) -> list[str]:
    """Return a note if bodies without memory have moved much further than expected; collective."""
    further = norm(problem.comm, problem.owned_u - start)
    if problem.solid.state or not further > FURTHER * expected:
        return []
    return [
        f"the bodies have moved {further / expected:.1f} times as far as their stiffness at the "
        "start of the step lets expect: they may have snapped through, since the loads may have "
        "passed a limit point on the way. Take smaller load steps to see, or prescribe "
        "displacements"
    ]
