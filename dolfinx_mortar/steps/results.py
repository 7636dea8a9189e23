# SPDX-License-Identifier: MIT
"""From the last balance of a step to the results of its interfaces, and what to say of them."""

from __future__ import annotations

import logging

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.interfaces import results
from dolfinx_mortar.interfaces.motions import slipped
from dolfinx_mortar.interfaces.near import nodal_gaps
from dolfinx_mortar.steps.linearisation import Balance
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.residuals import Contacts

log = logging.getLogger(__name__)


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


def notes_on_sliding(problem: ContactProblem, contacts: Contacts) -> list[str]:
    """Return a note for every contact that has slid too far for frozen geometry; collective."""
    if problem.geometry == "updated":
        return []
    notes, length = [], problem.system.facet_length
    for link in problem.system.links:
        slip = slipped(link, problem.vector(problem.u.x.array[: problem.d * problem.n]))
        slip[~contacts.active[link.nodes]] = 0.0
        farthest = float(maximum(problem.comm, slip.max(initial=0.0))[0])
        if link.interface.one_sided and farthest > length:
            notes.append(
                f"{link.interface} has slid {farthest:.3g}, {farthest / length:.1f} facet lengths, "
                "with frozen geometry, which is for small sliding; choose geometry='updated'"
            )
    if problem.comm.rank == 0:
        for note in notes:
            log.warning("%s", note)
    return notes
