# SPDX-License-Identifier: MIT
"""Tunnelling: steps in which bodies pass through each other are rejected."""

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.mortar.passing import (
    Middles,
    Passing,
    find_middles,
    find_passed,
    find_passed_tool,
    is_far,
)
from dolfinx_mortar.mortar.surface import cells_of
from dolfinx_mortar.problem.problem import ContactProblem


def describe_passing(problem: ContactProblem) -> str:
    """Describe bodies or tools that passed through each other since the last commit; collective.

    Empty for none.

    Raises:
        ValueError: on all ranks, if all nodes of the slave side are prescribed.
    """
    d, n, system = problem.d, problem.n, problem.system
    before, now = problem.committed.displacement, problem.u.x.array[: d * n]
    began: fem.Function | None = None
    if system.middles is None:
        system.middles = _find_middles(problem)
    for interface, middles, sides in zip(
        system.interfaces, system.middles, system.sides, strict=True
    ):
        if not middles:
            continue
        tool, (side, *other) = interface.tool, middles
        if other and not is_far(side, other[0], before.reshape(n, d), now.reshape(n, d)):
            continue
        if began is None:
            began = fem.Function(problem.V)
            began.x.array[: d * n] = before
            began.x.scatter_forward()
        if tool is None:
            found = find_passed(side, other[0], began, problem.u)
        else:
            found = find_passed_tool(side, began, problem.u, tool.seen())
        if found is not None:
            at = [float(f"{x:.4g}") for x in found.place]
            if found.surface is None:
                return f"{interface}: {_through_tool(found, at)}"
            name = "master" if found.surface is side.surface else "slave"
            if not any_rank(problem.comm, not sides.fixed[sides.nodes].all())[0]:
                raise ValueError(_without_effect(interface, sides.slave.label))
            return (
                f"{interface}: the {name} side has passed through the other one, at "
                f"{found.count} facets, such as the one that began around {at}; no step may bring "
                f"the middle of a body, {found.depth:.3g} behind that facet, into the other body"
            )
    return ""


def _without_effect(interface: Interface, slave: str) -> str:
    return (
        f"{interface}: Dirichlet data prescribe all nodes of slave={slave} and move them through "
        "the master: no slave node has a multiplier, so that the contact has no effect; let the "
        "other side be the slave"
    )


def _through_tool(found: Passing, at: list[float]) -> str:
    if not found.count:
        return (
            f"the tool has passed through the side, as has its point, which began around {at}; no "
            f"step may bring that point, {found.depth:.3g} deep in the tool, into the body"
        )
    return (
        f"the side has passed through the tool, at {found.count} facets, such as the one that began"
        f" around {at}; no step may bring the middle of the body, {found.depth:.3g} behind that "
        "facet, into the tool"
    )


def _find_middles(problem: ContactProblem) -> list[tuple[Middles, ...]]:
    """Mid-surface points of the bodies on all sides of each contact; collective."""
    if not any(problem.system.opposite):
        return [()] * len(problem.interfaces)
    body_of = problem.bodies.of_cells
    found = []
    boundary = problem.system.boundary
    for surfaces in problem.system.opposite:
        parts = [
            find_middles(s, body_of[cells_of(s)], boundary.facets, body_of[boundary.cells])
            for s in surfaces
        ]
        found.append(tuple(parts))
    return found
