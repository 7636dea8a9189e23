# SPDX-License-Identifier: MIT
"""The range of plasticity in the logarithmic strain space, measured after every step."""

from dolfinx_mortar.problem.problem import ContactProblem

# What simple shear by gamma = 1 costs; gamma = .5 costs 0.3 %, gamma = 2 17 %.
LARGEST_SHARE = 0.025


def notes_on_lost_stress(problem: ContactProblem) -> list[str]:
    """Say where laws in the additive form are out of their range; collective."""
    share, name = problem.solid.stress_lost()
    if share < LARGEST_SHARE:
        return []
    return [
        f"{name} runs in the logarithmic strain space, where shears soften: the stress is up to "
        f"{100 * share:.0f} % below that of the law (3 % where a shear reaches 1, 17 % at 2). "
        "Isotropic laws, without kinematic hardening, have no such limit"
    ]
