# SPDX-License-Identifier: MIT
"""Tunnelling: a step in which bodies have passed through each other is rejected."""

from dolfinx import fem
from dolfinx_mortar.mortar.passing import Middles, find_middles, find_passed, is_far
from dolfinx_mortar.mortar.surface import cells_of
from dolfinx_mortar.problem.problem import ContactProblem


def describe_passing(problem: ContactProblem) -> str:
    """Return which bodies have passed through each other since the last commit; collective.

    Empty if none has. Costs a few numbers per contact, unless sides have moved against each other
    by more than half of the thinner body; once, how thick these are.
    """
    d, n, system = problem.d, problem.n, problem.system
    before, now = problem.committed.displacement, problem.u.x.array[: d * n]
    began: fem.Function | None = None
    if system.middles is None:
        system.middles = _find_middles(problem)
    for interface, middles in zip(system.interfaces, system.middles, strict=True):
        if not middles or not is_far(*middles, before.reshape(n, d), now.reshape(n, d)):
            continue
        if began is None:
            began = fem.Function(problem.V)
            began.x.array[: d * n] = before
            began.x.scatter_forward()
        found = find_passed(*middles, began, problem.u)
        if found is not None:
            other = "master" if found.surface is middles[0].surface else "slave"
            at = [float(f"{x:.4g}") for x in found.place]
            return (
                f"{interface}: the {other} side has passed through the other one, at "
                f"{found.count} facets, such as the one that began around {at}; no step may bring "
                f"the middle of a body, {found.depth:.3g} behind that facet, into the other body"
            )
    return ""


def _find_middles(problem: ContactProblem) -> list[tuple[Middles, Middles] | None]:
    """Return the middles of the bodies on both sides of each contact, None for ties; collective."""
    if not any(problem.system.opposite):
        return [None] * len(problem.interfaces)
    body_of = problem.bodies.of_cells
    found: list[tuple[Middles, Middles] | None] = []
    boundary = problem.system.boundary
    for surfaces in problem.system.opposite:
        parts = [
            find_middles(s, body_of[cells_of(s)], boundary.facets, body_of[boundary.cells])
            for s in surfaces or ()
        ]
        found.append((parts[0], parts[1]) if parts else None)
    return found
