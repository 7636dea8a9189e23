# SPDX-License-Identifier: MIT
"""Which slave nodes take part in the change of basis: those that the master may reach.

Far from the contact T would couple the bodies where they cannot meet, which costs fill in every
factorisation, and new pairs wherever curved sides slide past each other at a distance. So T holds
the near nodes only, and the gaps of the others are watched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import Actives, Floats

if TYPE_CHECKING:
    from dolfinx_mortar.steps.problem import ContactProblem


# What counts as near: this share of the largest prescribed increment, plus so many facet lengths.
INCREMENT_SHARE, FACETS = 0.25, 2.0
# T gets room for so many times that distance, so that it need not change in every step.
ROOM = 2.0
# Two round bodies that overlap by delta touch where they would overlap by half of it (Hertz: a^2 =
# R delta, while the overlap ends at 2 R delta).
OVERLAP = 0.5


def _expected_motion(problem: ContactProblem) -> Floats:
    """Return (owned dofs,) the motion of each body by the mean of its prescribed increments."""
    mean = problem.bodies.mean(problem.dirichlet_increment(), problem.fixed[: problem.n])
    return np.asarray(mean[problem.bodies.label].ravel())


def expected_displacement(problem: ContactProblem) -> fem.Function | None:
    """Return u plus the expected motion, None if the geometry is frozen.

    Pairs, normals and segments of a step's first iteration are taken there: a disc that is pressed
    down by many facet lengths meets other partners than where it started.
    """
    if problem.configuration is None or not problem.interfaces:
        return None
    trial, motion = problem.increment, _expected_motion(problem)
    trial.x.array[: len(motion)] = problem.u.x.array[: len(motion)] + motion
    trial.x.scatter_forward()
    return trial


def predicted_gaps(problem: ContactProblem) -> Floats:
    """Return (owned nodes,) the gaps after the expected motion."""
    gap, motion = problem.gaps(), problem.vectors["dy"]
    motion.array[:] = _expected_motion(problem)
    for contact in problem.contacts:
        kept = contact.kept[:, 0]
        gap[contact.pattern.nodes[kept]] -= contact.relative(motion)[kept, 0]
    return gap


def _near(problem: ContactProblem) -> tuple[Floats, float]:
    """Return the predicted gaps and the distance beyond the nearest that counts as near."""
    gap = predicted_gaps(problem)
    increment = np.abs(problem.dirichlet_increment()).max(initial=0.0)
    increment, opposite = maximum(problem.comm, increment, -gap.min(initial=np.inf))
    nearest = max(-opposite, 0.0) if np.isfinite(opposite) else 0.0
    return gap - nearest, float(INCREMENT_SHARE * increment + FACETS * problem.facet_length)


def covers_contact(problem: ContactProblem) -> bool:
    """Tell whether T holds all slave nodes that are near the master; collective."""
    gap, distance = _near(problem)
    missing = [(gap[c.pattern.nodes[~c.near]] <= distance).any() for c in problem.contacts]
    return not any_rank(problem.comm, any(missing))[0]


def restrict(problem: ContactProblem) -> None:
    """Choose the slave nodes that T will hold; collective."""
    gap, distance = _near(problem)
    near = (gap <= ROOM * distance) | (problem.gaps() <= 0.0)
    for contact in problem.contacts:
        contact.restrict(near[contact.pattern.nodes])


def touches_far_nodes(problem: ContactProblem) -> bool:
    """Tell whether the master has reached a slave node that T does not hold; collective."""
    gap = problem.gaps()
    touched = [(gap[c.pattern.nodes[~c.near]] <= 0.0).any() for c in problem.contacts]
    return bool(any_rank(problem.comm, any(touched))[0])


def predict_active(problem: ContactProblem) -> Actives:
    """Return a first guess of the contact set, int8 on the bounded unknowns; collective.

    The set of the last step where there is one; otherwise nodes that overlap once every body moved
    by the mean of its prescribed increments, as deeply as where round bodies touch in the end;
    where none does, the nodes nearest.
    """
    marked = problem.active[problem.bounded_nodes]
    if not any_rank(problem.comm, marked.any())[0] and problem.contacts:
        gap = predicted_gaps(problem)
        nearest = -float(maximum(problem.comm, -gap.min(initial=np.inf))[0])
        depth = nearest if nearest > 0.0 else OVERLAP * nearest
        marked = gap[problem.bounded_nodes] <= depth + 1e-6 * problem.facet_length
    return marked.astype(np.int8)
