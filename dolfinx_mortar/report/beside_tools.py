# SPDX-License-Identifier: MIT
"""Facets beside the side of a tool that have moved into the tool, where nothing holds them."""

from collections.abc import Sequence

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Bools
from dolfinx_mortar.geometry.facets import facet_sizes
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.obstacle import Obstacle
from dolfinx_mortar.mortar.surface import Boundary
from dolfinx_mortar.report.overlaps import SUNK, find_deepest


def notes_beside_tools(
    links: Sequence[Link], boundary: Boundary, u: fem.Function, closed: Bools
) -> list[str]:
    """Return a note for every tool that a body has folded into beside its side; collective.

    An upset cylinder folds its lateral face onto the tool. Judged are exterior facets with a closed
    node of the side, which do not belong to it, and of which a node was outside of the tool at X.
    Not the rest of a flat face of which a tool presses a part: its nodes lay on the tool.

    Args:
        links: interfaces.
        boundary: all exterior facets.
        u: the displacement.
        closed: (owned nodes,) where contacts are.
    """
    notes = []
    for link in links:
        if not isinstance(link.interface, Obstacle):
            continue
        tool, slave = link.interface.tool, link.sides.slave
        marks = la.vector(slave.V.dofmap.index_map)
        own = slave.nodes[: slave.owned]
        marks.array[own] = closed[own]
        marks.scatter_forward()
        beside = (marks.array[boundary.nodes] > 0.0).any(axis=1)
        beside &= ~np.isin(boundary.entities, slave.entities)
        before, x = (boundary.at(at).x[beside] for at in (None, u))
        m, k, d = x.shape
        with raised_together(slave.V.mesh.comm):
            apart = tool.asked.distance(before.reshape(-1, d)).value.reshape(m, k)
            depth = -tool.pose().distance(tool.asked, x.reshape(-1, d)).value.reshape(m, k)
        length = facet_sizes(x)[:, None]
        share = np.where(apart > SUNK * length, depth / length, 0.0)
        at = share.ravel(), depth.ravel(), x.reshape(-1, d)
        ratio, deepest, place = find_deepest(slave.V.mesh.comm, *at)
        if ratio > SUNK:
            notes.append(
                f"{link.interface}: around ({', '.join(f'{c:.4g}' for c in place)}) the body lies "
                f"{deepest:.3g} deep in the tool, {ratio:.0%} of a facet there, beside "
                f"slave={slave.label}: add the facets there to it, so that they meet the tool"
            )
    return notes
