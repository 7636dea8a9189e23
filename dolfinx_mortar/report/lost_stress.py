# SPDX-License-Identifier: MIT
"""The range of plasticity in the logarithmic strain space, measured after every step."""

from dolfinx_mortar.problem.problem import ContactProblem

# Of a perfectly plastic body in simple shear by 1, where the shear stress is 2.7 % low; by .5, 2
# and 5: .002, .089, .137, and 0.3, 17, 56 % of the shear stress.
LARGEST_SHARE = 0.02


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
