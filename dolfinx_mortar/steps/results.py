# SPDX-License-Identifier: MIT
"""From the last balance of a step to the results of its interfaces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dolfinx_mortar.interfaces import results
from dolfinx_mortar.interfaces.near import nodal_gaps
from dolfinx_mortar.steps.linearisation import Balance
from dolfinx_mortar.steps.residuals import Contacts

if TYPE_CHECKING:
    from dolfinx_mortar.steps.problem import ContactProblem


def set_results(problem: ContactProblem, balance: Balance, contacts: Contacts) -> None:
    """Set the interfaces' resultants and Functions; collective.

    Reactions of equalities are the residual forces that they take; those of contact are D_jj times
    the multipliers.
    """
    d, n = problem.d, problem.n
    moved = problem.X + problem.u.x.array[: d * n].reshape(-1, d)
    reaction = np.zeros(d * n)
    reaction[balance.equal.dofs] = balance.reduced.array_r[balance.equal.dofs]
    reaction[balance.bounds.dofs] = contacts.reactions(balance)
    forces = reaction.reshape(-1, d)
    gap = nodal_gaps(problem.system.links, problem.vector(moved), n)
    for link in problem.system.links:
        frozen = link.interface.configuration(problem.configuration) is None
        on = link.constrained
        one_sided = link.interface.one_sided
        active = contacts.active[link.nodes] if one_sided else link.coupling.kept.any(axis=1)
        results.set_results(
            link,
            np.where(on, forces[link.nodes], 0.0),
            gap[link.nodes] if one_sided else np.zeros(len(link.nodes)),
            np.asarray(active & (on.any(axis=1) | (not one_sided))),
            problem.X if frozen else moved,  # where the forces act
        )
