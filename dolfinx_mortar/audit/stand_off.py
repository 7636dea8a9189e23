# SPDX-License-Identifier: MIT
"""Whether facets approximate curved sides well enough: before a step, and after it.

Facets deviate from the curved surface by their sagittas, which enter the gaps with different shares
from node to node. The forces K^_jj times these differences are compared with the contact forces.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum, norm, ratio
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.geometry.tolerances import HALF_OF_DIGITS
from dolfinx_mortar.interfaces.coupling import Link, stand_off
from dolfinx_mortar.mortar.curvature_correction import find_parting, find_smooth_sides
from dolfinx_mortar.mortar.surface import mean_facet_length

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


def _is_of_facets(link: Link) -> bool:
    """Tell whether a link is a contact between facets that can stand off curved surfaces."""
    of_facets = link.interface.one_sided and not link.interface.smooth
    return of_facets and not link.sides.slave.curved


def _uneven(comm: MPI.Comm, heights: Floats) -> Floats:
    """Return the differences from the mean over all ranks; collective."""
    total, count = comm.allreduce(np.array([heights.sum(), len(heights)]))
    return np.asarray(heights - total / max(count, 1))


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
    slave, contact = link.sides.slave, link.interface.one_sided
    if slave.curved or slave.element.degree == 1 or (contact and not link.interface.smooth):
        return []
    sides = find_smooth_sides(link.pairing, link.sides.fixed, link.interface.feature_angle)
    highest = max(np.abs(side.sagitta).max(initial=0.0) for side in sides)
    length = mean_facet_length(slave)
    if float(maximum(link.sides.V.mesh.comm, highest)[0]) <= HALF_OF_DIGITS * length:
        return []
    where, how = "curved sides", "of ties of degree 2 scatter by some per cent on any mesh"
    if contact:
        if find_parting(link.pairing, link.coupling.segments, u, sides) >= CLOSE:
            return []
        where, how = "curved sides that fit closely", "of degree 2 are far off on coarse meshes"
    return [
        f"{link.interface}: straight facets stand for {where}, where pressures {how}: take curved "
        "cells (Gmsh: mesh.setOrder(2)) or displacements of degree 1"
    ]


def notes_on_facets(
    links: Sequence[Link], u: fem.Function | None, forces: Floats, stiffness: Floats
) -> list[str]:
    """Return a note for each contact whose facets make its pressures inaccurate; collective.

    Smooth surfaces would be nearer by heights h_j; the forces K^_jj (h_j - mean of h), over the
    contact forces z_j, are the share by which pressures are wrong.

    Args:
        links: the interfaces, coupled at X + u.
        u: displacement, None for X.
        forces: (owned nodes,) of contact.
        stiffness: (owned nodes,) force per gap, K^_jj.
    """
    notes = []
    for link in links:
        if not _is_of_facets(link):
            continue
        smooth = find_smooth_sides(link.pairing, link.sides.fixed, link.interface.feature_angle)
        heights = stand_off(link, u, smooth)
        comm, on = link.sides.V.mesh.comm, forces[link.nodes] > 0.0
        uneven = _uneven(comm, heights[on])
        k, z = stiffness[link.nodes][on], forces[link.nodes][on]
        share = ratio(norm(comm, k * uneven), norm(comm, z))
        if share > SPOILT:
            highest = float(maximum(comm, np.abs(uneven).max(initial=0.0))[0])
            notes.append(
                f"{link.interface}: facets stand off the curved sides by {highest:.2g} more here "
                f"than there, worth {100 * share:.0f} % of the contact forces, so that pressures "
                "may be wrong; choose Contact(..., surface='smooth')"
            )
    return notes
