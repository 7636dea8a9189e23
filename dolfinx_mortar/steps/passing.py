# SPDX-License-Identifier: MIT
"""A step in which bodies pass through each other is none."""

from __future__ import annotations

from dolfinx import fem
from dolfinx_mortar.mortar.passing import find_passed, is_far
from dolfinx_mortar.steps.problem import ContactProblem


def describe_passing(problem: ContactProblem) -> str:
    """Return which bodies have passed through each other since the last commit; collective.

    Empty if none has. Costs four numbers per contact, unless sides have moved against each other by
    more than half of the thinner body.
    """
    d, n = problem.d, problem.n
    before, now = problem.committed.displacement, problem.u.x.array[: d * n]
    began: fem.Function | None = None
    for interface, sides in zip(problem.interfaces, problem.system.sides, strict=True):
        if not interface.one_sided:
            continue
        surfaces = sides.slave, sides.master
        if not is_far(*surfaces, before.reshape(n, d), now.reshape(n, d)):
            continue
        if began is None:
            began = fem.Function(problem.V)
            began.x.array[: d * n] = before
            began.x.scatter_forward()
        found = find_passed(*surfaces, began, problem.u)
        if found is not None:
            other = "master" if found.surface is sides.slave else "slave"
            at = [float(f"{x:.4g}") for x in found.place]
            return (
                f"{interface}: the {other} side has passed through the other one, at "
                f"{found.count} facets, such as the one that began around {at}; no step may bring "
                f"the middle of a body, {found.depth:.3g} behind that facet, into the other body"
            )
    return ""
