# SPDX-License-Identifier: MIT
"""Whether facets stand for curved sides well enough: told after a step, when the contact is known.

Facets stand off the surfaces that they stand for by their sagittas, which enter the gap, at every
node with another share. Where that is not smooth from node to node, it takes forces of K^_jj times
it to even it out; these are compared with the contact forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum, norm, ratio
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.coupling import Link, stand_off
from dolfinx_mortar.interfaces.interface import Interface

# Facets whose unevenness is worth this share of the contact forces spoil pressures. A pin in its
# hole, on ten meshes: its peak pressure is right to 2 % where the share is below 0.05, to 5 % below
# 0.2, and 30 to 130 % too high from 0.3 on. Hertz' problems have 0.01, on coarse tetrahedra 0.2.
SPOILT = 0.2


@dataclass(frozen=True)
class StandOff:
    """What the audit has found for a contact between facets, at its owned slave nodes."""

    interface: Interface
    heights: Floats  # (n,) by how much smooth surfaces would be nearer


def find_stand_offs(links: Sequence[Link], u: fem.Function | None) -> list[StandOff]:
    """Measure the contacts between facets; collective.

    Args:
        links: the interfaces, coupled at X + u.
        u: displacement, None for X.
    """
    return [
        StandOff(link.interface, stand_off(link, u))
        for link in links
        if link.interface.one_sided and not link.interface.smooth
    ]


def notes_on_facets(
    found: Sequence[StandOff], links: Sequence[Link], forces: Floats, stiffness: Floats
) -> list[str]:
    """Return a note for each contact whose facets are felt in its pressures; collective.

    Args:
        found: what the audit has measured.
        links: the interfaces.
        forces: (owned nodes,) of contact.
        stiffness: (owned nodes,) force per gap, K^_jj.
    """
    notes = []
    for mine in found:
        link = next(link for link in links if link.interface is mine.interface)
        comm, on = link.sides.V.mesh.comm, forces[link.nodes] > 0.0
        h, k, z = mine.heights[on], stiffness[link.nodes][on], forces[link.nodes][on]
        total, count = comm.allreduce(np.array([h.sum(), len(h)]))
        uneven = h - total / max(count, 1)
        share = ratio(norm(comm, k * uneven), norm(comm, z))
        if share > SPOILT:
            highest = float(maximum(comm, np.abs(uneven).max(initial=0.0))[0])
            notes.append(
                f"{link.interface}: facets stand off the curved sides by {highest:.2g} more here "
                f"than there, worth {100 * share:.0f} % of the contact forces, so that pressures "
                "may be wrong; choose Contact(..., surface='smooth')"
            )
    return notes
