# SPDX-License-Identifier: MIT
"""Whether facets approximate curved sides well enough, judged after a step from its contact.

Facets deviate from the curved surface by their sagittas, which enter the gaps with different shares
from node to node. The forces K^_jj times these differences are compared with the contact forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum, norm, ratio
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.curvature_correction import (
    find_parting,
    find_smooth_sides,
    point_heights,
)
from dolfinx_mortar.mortar.integrals import weighted_duals
from dolfinx_mortar.mortar.operators import mean_values
from dolfinx_mortar.mortar.surface import accumulate, mean_facet_length

# Pressures are inaccurate where the forces of the sagittas exceed this share of the contact
# forces. A pin in its hole, on ten meshes: its peak pressure is right to 2 % where the share is
# below 0.05, to 5 % below 0.2, and 30 to 130 % too high from 0.3 on. Hertz' problems have 0.01, on
# coarse tetrahedra 0.2.
SPOILT = 0.2
# Sides fit closely if what is left of their curvatures is less than this share of the larger one:
# then the gap grows, over a facet, by no more than the sagittas. A pin in a hole with facets 2/3
# as long, six of its facets in contact, has a peak pressure that is 112, 91, 62 and 25 % too high
# for a share of 0.1, 0.2, 0.33 and 0.5; a disc on a plane, where it is 1, one that is 6 % too
# high.
CLOSE = 0.5


@dataclass(frozen=True)
class StandOff:
    """What the audit has found for a contact between facets, at its owned slave nodes."""

    interface: Interface
    heights: Floats  # (n,) by how much smooth surfaces would be nearer
    uneven: float  # the largest difference from their mean, all ranks
    parting: float  # see `find_parting`
    slope: float  # uneven over the length of the larger facets

    @property
    def close(self) -> bool:
        """Tell whether the sides fit closely."""
        return self.parting < CLOSE

    def matters(self, strain: float) -> bool:
        """Tell whether pressures may suffer where sides are pressed in, for a body, by a strain."""
        return self.close and self.slope > SPOILT * strain


def find_stand_offs(links: Sequence[Link], u: fem.Function | None) -> list[StandOff]:
    """Measure the contacts between facets; collective.

    Args:
        links: the contacts, coupled at X + u.
        u: displacement, None for X.
    """
    return [_find_stand_off(link, u) for link in links if link.pairing and _is_of_facets(link)]


def _is_of_facets(link: Link) -> bool:
    """Tell whether a contact is one between facets that can stand off curved surfaces."""
    return not (link.interface.smooth or link.sides.slave.curved)


def _find_stand_off(link: Link, u: fem.Function | None) -> StandOff:
    pairing, segments, sides = link.mortar[0], link.mortar[1].segments, link.sides
    smooth = find_smooth_sides(pairing, sides.fixed, link.interface.feature_angle)
    kept = np.zeros(len(sides.slave.nodes))
    kept[: sides.slave.owned] = link.coupling.kept[:, 0]
    Phi = weighted_duals(pairing, segments, accumulate(sides.slave, kept) > 0)
    at_points = point_heights(pairing, segments, u, smooth)
    heights = mean_values(pairing, segments, Phi, link.coupling.weight[:, 0], at_points)
    uneven = _uneven(sides.V.mesh.comm, heights[link.coupling.kept[:, 0]])
    highest = float(maximum(sides.V.mesh.comm, np.abs(uneven).max(initial=0.0))[0])
    parting = find_parting(pairing, segments, u, smooth)
    length = max(mean_facet_length(side) for side in sides.surfaces)
    return StandOff(link.interface, heights, highest, parting, highest / length)


def _uneven(comm: MPI.Comm, heights: Floats) -> Floats:
    """Return the differences from the mean over all ranks; collective."""
    total, count = comm.allreduce(np.array([heights.sum(), len(heights)]))
    return np.asarray(heights - total / max(count, 1))


def warning_on_facets(found: StandOff, finer: bool) -> str:
    """Return the warning before a step about sides that fit closely.

    Args:
        found: what the audit has measured.
        finer: whether the slave side is the finer one.
    """
    swap = ", or else let the coarser side be the slave" if finer else ""
    return (
        f"{found.interface}: the sides fit so closely that the gap grows no faster than facets "
        f"stand off the curved surfaces, by {found.uneven:.2g} more here than there; pressures "
        f"and forces may be wrong: choose Contact(..., surface='smooth'){swap}"
    )


def warnings_on_straight_facets(link: Link, u: fem.Function | None = None) -> list[str]:
    """Return the warnings about second order on straight facets of curved sides; collective.

    Pressures of ties do not converge: those of rings with 20, 80 and 320 facets have a scatter
    (rms) of 2, 0.6 and 0.4 %, with the outer one as slave 3.5, 1.2 and 0.9 %; of first order 0.2,
    0.02 and 0.001 %. Those of contacts whose sides fit closely do, but where meshes are coarse they
    suffer from heights that are known too little: peaks of an elliptic pin in its hole (10 x 7)
    with 52, 73, 103 and 205 facets are 80, 29, 6 and 0.4 % too high; of first order 4, 2.6, 1.2 and
    0.3 %, on curved facets 0.3 % and less.

    Args:
        link: the interface, coupled at X + u.
        u: displacement, None for X.
    """
    slave, interface = link.sides.slave, link.interface
    if link.pairing is None or slave.curved or slave.element.degree == 1:
        return []
    where, how, only_close = interface.spoilt
    if only_close and not interface.smooth:
        return []
    pairing, segments = link.mortar[0], link.mortar[1].segments
    sides = find_smooth_sides(pairing, link.sides.fixed, interface.feature_angle)
    highest = max(np.abs(side.sagitta).max(initial=0.0) for side in sides)
    length = mean_facet_length(slave)
    if float(maximum(link.sides.V.mesh.comm, highest)[0]) <= HALF_OF_DIGITS * length:
        return []
    if only_close and find_parting(pairing, segments, u, sides) >= CLOSE:
        return []
    return [
        f"{interface}: straight facets stand for {where}, where pressures {how}: take curved "
        "cells (Gmsh: mesh.setOrder(2)) or displacements of degree 1"
    ]


def notes_on_facets(
    found: Sequence[StandOff], links: Sequence[Link], forces: Floats, stiffness: Floats
) -> list[str]:
    """Return a note for each contact whose facets make its pressures inaccurate; collective.

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
        uneven = _uneven(comm, h)
        share = ratio(norm(comm, k * uneven), norm(comm, z))
        if share > SPOILT:
            highest = float(maximum(comm, np.abs(uneven).max(initial=0.0))[0])
            notes.append(
                f"{link.interface}: facets stand off the curved sides by {highest:.2g} more here "
                f"than there, worth {100 * share:.0f} % of the contact forces, so that pressures "
                "may be wrong; choose Contact(..., surface='smooth')"
            )
    return notes
