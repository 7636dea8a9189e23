# SPDX-License-Identifier: MIT
"""Whether facets approximate curved sides well enough: degree 2 before a step, others after it.

Facets deviate from the curved surface by their sagittas, which enter the gaps with different shares
from node to node. The forces K^_jj times these differences are compared with the contact forces.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum, norm, ratio
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats
from dolfinx_mortar.geometry.curvature import unit
from dolfinx_mortar.geometry.facets import points_of
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tool import SidePattern, Tool, find_facing, point_gaps
from dolfinx_mortar.mortar.curvature_correction import (
    SmoothSide,
    find_parting,
    find_smooth_sides,
    missed_heights,
    point_heights,
)
from dolfinx_mortar.mortar.duals import weighted_duals
from dolfinx_mortar.mortar.operators import mean_values
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    accumulate,
    coordinates,
    facets_at,
    mean_facet_length,
)
from dolfinx_mortar.mortar.whole_side import whole_facets

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
Find = Callable[
    [Pairing, Segments, fem.Function | None, tuple[SmoothSide, SmoothSide]],
    Floats,
]


def _means(link: Link, u: fem.Function | None, find: Find) -> Floats:
    """Return the means (n,) at the slave nodes of what sides have at points; collective.

    Values (q,), or (q, k) for each node of the facets.
    """
    (pairing, operators), sides = link.mortar, link.sides
    smooth = link.pattern.smooth or link.pattern.nearby
    assert smooth is not None, "of contacts only"
    kept = np.zeros(len(sides.slave.nodes))
    kept[: sides.slave.owned] = link.coupling.kept[:, 0]
    Phi = weighted_duals(pairing, operators.segments, accumulate(sides.slave, kept) > 0)
    at_points = find(pairing, operators.segments, u, smooth)
    if at_points.ndim > 1:
        Phi, at_points = Phi * at_points, np.ones(len(Phi))
    return mean_values(pairing, operators.segments, Phi, operators.weight[:, 0], at_points)


def missed_gaps(link: Link, u: fem.Function | None) -> Floats:
    """Return by how much gaps (n,) are larger than those of round sides; collective.

    Of sides that touch, whose gaps would be zero: by what heights miss, and because a gap along the
    normal n at a point counts along n_j, int Phi_j (n_j - n).(x_m - x_s) / D_jj, where x_m - x_s is
    as long as the sagittas of both.
    """
    sides, own = link.sides, link.coupling.normals
    normals: Floats = np.zeros((len(sides.slave.nodes), own.shape[1]))
    normals[: sides.slave.owned] = own
    normals = accumulate(sides.slave, normals)

    def find(pairing: Pairing, segments: Segments, *rest: Any) -> Floats:
        slave = facets_at(pairing.slave, coordinates(pairing.slave, u))
        v = points_of(received_facets(pairing, u), segments.master, segments.xi_m)
        v -= points_of(slave, segments.slave, segments.xi_s)
        N = pairing.slave.element.shape_functions(segments.xi_s)
        at_nodes = normals[pairing.slave.facets[segments.slave]]
        n = unit((N[:, None] @ at_nodes)[:, 0])
        missed = missed_heights(pairing, segments, *rest) - (n * v).sum(axis=1)
        return np.asarray((at_nodes @ v[:, :, None])[:, :, 0] + missed[:, None])

    return _means(link, u, find)


def _are_flat(link: Link, sides: tuple[SmoothSide, SmoothSide]) -> bool:
    """Tell whether neither of both sides has sagittas that are more than round-off; collective."""
    highest = max(np.abs(side.sagitta).max(initial=0.0) for side in sides)
    length = mean_facet_length(link.sides.slave)
    return float(maximum(link.sides.V.mesh.comm, highest)[0]) <= HALF_OF_DIGITS * length


def warnings_on_straight_facets(link: Link, u: fem.Function | None = None) -> list[str]:
    """Return the warnings about second order on straight facets of curved sides; collective.

    Pressures of ties do not converge: those of rings with 20, 80 and 320 facets have a scatter
    (rms) of 2, 0.6 and 0.4 %, with the outer one as slave 3.5, 1.2 and 0.9 %; of first order 0.2,
    0.02 and 0.001 %. Those of contacts whose sides fit closely do, but where meshes are coarse they
    suffer from heights that are known too little: peaks of an elliptic pin in its hole (10 x 7)
    with 52, 73, 103 and 205 facets are 80, 29, 6 and 0.4 % too high; of first order 4, 2.6, 1.2 and
    0.3 %, on curved facets 0.3 % and less.

    Args:
        u: displacement, None for X.
    """
    slave, interface = link.sides.slave, link.interface
    if link.pairing is None or slave.curved or slave.element.degree == 1:
        return []
    if link.unilateral and not interface.smooth:
        return []
    pairing, segments = link.mortar[0], link.mortar[1].segments
    sides = find_smooth_sides(pairing, link.sides.fixed, interface.feature_angle, link.sides.shapes)
    if _are_flat(link, sides):
        return []
    if link.unilateral and find_parting(pairing, segments, u, sides) >= CLOSE:
        return []
    where, how = "curved sides", "of ties of degree 2 scatter by some per cent on any mesh"
    if link.unilateral:
        where, how = "curved sides that fit closely", "of degree 2 are far off on coarse meshes"
    return [
        f"{interface}: straight facets stand for {where}, where pressures {how}: take curved "
        "cells (Gmsh: mesh.setOrder(2)) or displacements of degree 1"
    ]


def note_on_facets(
    link: Link,
    x: PETSc.Vec,
    u: fem.Function | None,
    forces: Floats,
    stiffness: Floats,
    diagonal: Callable[[], PETSc.Vec],
    potential: Callable[[], float | None],
) -> str:
    """Return the note on a contact if facets make its pressures inaccurate, else ""; collective.

    Gaps are known to h_j: of facets, by which smooth surfaces, of tools too, would be nearer, less
    the mean where nodes carry; of smooth surfaces of degree 1, what they miss of round sides
    (`missed_gaps`). Compared with the contact forces z_j are K^_jj h_j, with the stiffness of both
    sides in series (`_in_series`), at the nodes that carry; of smooth surfaces, and where none
    carries, also at those that might, as the gap is less than h_j.

    Smooth surfaces of rings that fit, with 16 to 52 facets, errors of forces and of the worst
    pressure: below a share of .2 up to 5 and 12 %, at .5 to .9 14 to 39 and 22 to 95 %. An even h_j
    is counted two to four times, with the stiffness of single nodes.

    Args:
        x: where the nodes are, X + u.
        u: displacement by which facets have moved, None for X.
        forces: (owned nodes,) of contact.
        stiffness: (owned nodes,) force per gap, K^_jj.
        diagonal: gives that of K, of the bodies alone.
        potential: gives that of the bodies at u, see `Solid.potential`.
    """
    comm, k, z = link.sides.V.mesh.comm, stiffness[link.nodes], forces[link.nodes]
    on, meshed = z > 0.0, link.pairing is not None
    touches = any_rank(comm, on.any())[0]
    even = _missed(link, u) if touches or meshed else None
    if even is None:
        return ""
    missed, smooth = even, meshed and link.interface.smooth
    if smooth or not touches:
        least = HALF_OF_DIGITS * mean_facet_length(link.sides.slave)
        near = np.abs(missed) if smooth else missed - least
        on = on | (link.coupling.kept[:, 0] & (link.gaps(x) <= near))
    else:
        total, count = comm.allreduce(np.array([missed[on].sum(), on.sum()]))
        missed = missed - total / max(count, 1)
    share = ratio(norm(comm, k[on] * missed[on]), norm(comm, z))
    if meshed and SPOILT < share < np.inf:
        k = _in_series(link, k, diagonal())
        share = ratio(norm(comm, k[on] * missed[on]), norm(comm, z))
    if share <= SPOILT:
        return "" if meshed else _even_facets(link, even, z, potential)
    largest = float(maximum(comm, np.abs(missed[on]).max(initial=0.0))[0])
    remedy = "refine" if smooth else f"choose {type(link.interface).__name__}(.., surface='smooth')"
    worth = "and no node carries: forces may be missing"
    if np.isfinite(share):
        worth = f"worth up to {100 * share:.0f} % of the contact forces, which may be wrong"
    what = "smooth surfaces through the nodes" if smooth else "facets of curved sides"
    return f"{link.interface}: gaps of {what} are known to {largest:.2g} here, {worth}; {remedy}"


def _missed(link: Link, u: fem.Function | None) -> Floats | None:
    """Return by how much gaps (n,) are too large, None where that is not known; collective."""
    if link.pairing is None:
        faceted = link.pattern.faceted if isinstance(link.pattern, SidePattern) else None
        if faceted is None:  # a flat side
            return None
        tool = link.interface.tool
        heights = None if tool is None else _heights_at_tool(link, tool, u)
        return None if heights is None else np.asarray(heights * faceted)
    if not link.interface.smooth:
        return _means(link, u, point_heights)
    assert link.pattern.smooth is not None
    first = link.sides.slave.element.degree == 1
    return missed_gaps(link, u) if first and not _are_flat(link, link.pattern.smooth) else None


def _heights_at_tool(link: Link, tool: Tool, u: fem.Function | None) -> Floats | None:
    """Return how much nearer a tool would be to smooth surfaces (n,) at the owned slave nodes.

    None where facets are what is meant, or stand for these already; collective.
    """
    pattern, slave = link.pattern, link.sides.slave
    assert isinstance(pattern, SidePattern) and pattern.side is not None
    if slave.element.degree > 1 or pattern.nodal:
        return None
    side, pose, x = pattern.side, tool.pose(), coordinates(slave, u)
    segments, points = whole_facets(side, x, find_facing(side, pose, tool.asked, x))
    facets, smooth = (
        point_gaps(which, pose, tool.asked, u, segments, points)[0]
        for which in (pattern, replace(pattern, nodal=True))
    )
    kept = np.zeros(len(slave.nodes))
    kept[: slave.owned] = link.coupling.kept[:, 0]
    Phi = weighted_duals(side, segments, accumulate(slave, kept) > 0.0)
    return mean_values(side, segments, Phi, link.coupling.weight[:, 0], facets - smooth)


def _in_series(link: Link, k: Floats, diagonal: PETSc.Vec) -> Floats:
    """Return the stiffness (n,) of slave nodes in series with that of the master; collective.

    A force n_j on slave node j is P_jl n_j on the master's nodes, which give by sum_l P_jl^2
    n_j.(n_j / K_ll).

    Args:
        k: (n,) of the slave nodes alone.
        diagonal: of K.
    """
    n, P, own = link.coupling.normals, link.pattern.scalars, diagonal.array_r
    P.fill(link.coupling.P[:, 0, None, None] ** 2)
    softness, give = P.matrix.createVecRight(), np.zeros(len(k))
    inverse = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0.0)
    for i in range(n.shape[1]):
        softness.array[:] = inverse[i :: n.shape[1]]
        give += n[:, i] ** 2 * (P.matrix * softness).array_r[link.nodes]
    return np.asarray(k / (1.0 + k * give))


def _even_facets(
    link: Link, heights: Floats, z: Floats, potential: Callable[[], float | None]
) -> str:
    """Return the note on a round side whose facets stand off a tool everywhere; collective.

    With the forces F of an overlap w bodies store Psi = F w / 2. Facets add -h to w: the work
    -z.h of the forces is 2 Psi (1 - F'/F), where F' is the force of the smooth surface. Rings of 4,
    8, 16, 32 and 64 facets a quarter on a shaft that fits: .866, .617, .287, .091 and .025 of 2
    Psi, and 1 - F'/F is .868, .618, .286, .090 and .023, in the plane and in space. On a shaft that
    is 1 % thinner and pressed to one side, .49 and .17 for .507 and .191 with 8 and 16 facets; with
    32 and 64, where forces are off by .055 and .014, there is no note. What other loads store is in
    Psi, too, and makes the share smaller.
    """
    stored, comm = potential(), link.sides.V.mesh.comm
    work = comm.allreduce(float(z @ heights))
    share = 0.0 if stored is None else float(ratio(abs(work), 2.0 * abs(stored)))
    if share <= 0.25 * SPOILT:  # forces are right to 5 %
        return ""
    mean = abs(work) / comm.allreduce(float(z.sum()))
    return (
        f"{link.interface}: facets stand off the round side by {mean:.2g} on average, whose work "
        f"is {100 * share:.0f} % of that of the contact forces, which may be wrong by that much "
        "and more; choose Obstacle(.., surface='smooth'), or refine"
    )
