# SPDX-License-Identifier: MIT
"""The range of plasticity in the logarithmic strain space, measured after every step."""

from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.small_strain import LARGEST_SHARE


def notes_on_lost_stress(problem: ContactProblem) -> list[str]:
    """Say where laws in the additive form are out of their range; collective."""
    share, name = problem.solid.stress_lost()
    if share < LARGEST_SHARE:
        return []
    return [
        f"{name} runs in the logarithmic strain space, where shears soften: the norm of the stress "
        f"is up to {100 * share:.0f} % below that of the law (2 % where a shear reaches 1, whose "
        "stress is then 3 % too low; 9 % at 2, with 17 %). Isotropic laws, without kinematic "
        "hardening, have no such limit"
    ]
