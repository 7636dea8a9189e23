# SPDX-License-Identifier: MIT
"""Audit of the two sides of each interface."""

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import HALF_OF_DIGITS
from dolfinx_mortar.geometry.facets import Facets, facet_normals, facet_sizes
from dolfinx_mortar.geometry.segments import FACING
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.curvature_correction import SmoothSide, find_parting, find_smooth_sides
from dolfinx_mortar.mortar.duals import find_coverage, node_weights
from dolfinx_mortar.mortar.integrals import find_segments, point_distances
from dolfinx_mortar.mortar.pairing import Pairing
from dolfinx_mortar.mortar.surface import mean_facet_length

# Ratio of slave to master facets without a warning, half of that where the peak of a disc on a
# block is still right to .7 % (6 % at 8).
COARSE = 2.0


# Ratio of sagitta error to contact forces with a warning: the peak pressure of a pin is wrong by 5
# % below it, by 30 % and more from 0.3 on.
SPOILT = 0.2
# Relative curvature of closely fitting sides over the larger one: peak pressures are up to 25 % too
# high above it.
CLOSE = 0.5


@dataclass(frozen=True)
class Edges:
    """Nodes of both smooth sides where facets are kept, all ranks."""

    feature_angle: float
    nodes: int
    without_normal: int  # normals cancel


@dataclass(frozen=True)
class TieReach:
    """Distances of points tied at X, all ranks."""

    farthest: float  # 0 without ties
    share: float  # distance over the larger facet
    beyond: int  # slave nodes beyond the reach


@dataclass(frozen=True)
class InterfaceAudit:
    """Counts of one interface, all ranks."""

    name: str
    slave_facets: int
    master_facets: int
    slave_nodes: int
    kept_nodes: int
    uncovered_nodes: int  # gap not-a-number, "facing" 0
    removed_nodes: int  # facing a master, removed by Dirichlet data or another contact
    dirichlet_nodes: int  # all directions prescribed
    facing_away: int  # slave facets that touch master facets from behind
    size_ratio: float  # mean facet lengths, slave over master; 1 without a master
    least_gap: float  # of kept nodes, negative in an overlap
    largest_gap: float  # not-a-number without a master or tool
    edges: Edges | None = None  # of smooth surfaces
    reach: TieReach | None = None
    unheld: int = 0  # slave facets whose multipliers Dirichlet data prevent
    meets_itself: bool = False

    def __str__(self) -> str:
        gap = f", gaps from {self.least_gap:.3g} to {self.largest_gap:.3g}"
        if np.isnan(self.least_gap):
            gap = ""
        elif self.least_gap < 0.0:
            gap += f" (overlap {-self.least_gap:.3g})"
        edges, reach = self.edges, self.reach
        if edges is not None:
            gap += f", {edges.nodes} nodes on edges of {edges.feature_angle:g} degrees or more"
        if reach is not None:
            gap += f", tied over distances up to {reach.farthest:.3g}"
            gap += f", {reach.beyond} nodes farther apart are not" if reach.beyond else ""
        return (
            f"{self.name}: {self.slave_facets} slave and {self.master_facets} master facets"
            f"{' near each other' if self.meets_itself else ''}, "
            f"{self.kept_nodes} of {self.slave_nodes} slave nodes carry a multiplier, "
            f"{self.uncovered_nodes} face no master, {self.removed_nodes} removed{gap}"
        )


def audit_sides(link: Link, x: PETSc.Vec) -> InterfaceAudit:
    """Count over the slave side of one interface; collective."""
    sides, kept = link.sides, link.coupling.kept.any(axis=1)
    covered = link.coupling.coverage.faces | kept
    gap = link.gaps(x)[kept]
    x = np.abs(sides.V.mesh.geometry.x).max(initial=0.0)
    both = (-gap).max(initial=-np.inf), gap.max(initial=-np.inf)
    least, largest, size = maximum(sides.V.mesh.comm, *both, x)
    itself = link.sides.meet_themselves
    counts = sides.V.mesh.comm.allreduce(
        np.array(
            [
                *_count_facets(link),
                len(link.nodes),
                kept.sum(),
                (~covered).sum(),
                (covered & ~kept).sum(),
                (link.prescribed & ~link.banned[link.nodes]).sum(),
                _count_facing_away(link.pairing) if link.pairing and not itself else 0,
            ]
        ),
        op=MPI.SUM,
    )
    lengths = [mean_facet_length(s) for s in sides.surfaces]
    ratio = float(lengths[0] / lengths[-1])
    # round-off of coordinates is no gap
    size = ROUND_OFF * max(float(lengths[0]), float(size))
    if sides.hold:
        least = largest = np.nan
    ends = [0.0 if abs(end) < size or np.isinf(end) else float(end) for end in (-least, largest)]
    edges = None
    if link.pattern.smooth and not sides.slave.curved:
        own = np.sum([side.edges for side in link.pattern.smooth], axis=0)
        nodes, without = sides.V.mesh.comm.allreduce(own)
        edges = Edges(link.interface.feature_angle, int(nodes), int(without))
    row = *map(int, counts), ratio, *ends, edges, _measure_reach(link), _count_unheld(link), itself
    return InterfaceAudit(repr(link.interface), *row)  # type: ignore[arg-type]


def _count_facets(link: Link) -> tuple[int, int]:
    sides, pairing = link.sides, link.pairing
    if sides.master is None:
        return len(sides.slave.facets), 0
    if pairing is None or pairing.roles is None:
        return len(sides.slave.facets), len(sides.master.facets)
    seen = np.unique(pairing.roles.seen // max(len(pairing.roles.copies), 1))
    slaves = int(pairing.roles.slave[seen].sum())
    return slaves, len(seen) - slaves


def _count_facing_away(pairing: Pairing) -> int:
    """Slave facets that touch the back of a master facet, within a facet length."""
    x_s = pairing.slave.X[pairing.slave.facets]
    x_m = pairing.master_X[pairing.master_facets]
    if len(x_s) == 0 or len(x_m) == 0:
        return 0
    distance, nearest = scipy.spatial.cKDTree(x_m.mean(axis=1)).query(x_s.mean(axis=1))
    n_s = facet_normals(Facets(pairing.slave.element, x_s))
    n_m = facet_normals(Facets(pairing.master.element, x_m))
    opposed = np.einsum("mi,mi->m", n_s, n_m[nearest])
    return int(((distance < facet_sizes(x_s)) & (opposed > FACING)).sum())


def _measure_reach(link: Link) -> TieReach | None:
    if link.unilateral or link.pairing is None:
        return None
    pairing, segments = link.mortar[0], link.mortar[1].segments  # ties stay at X
    everything, _ = find_segments(pairing, None)
    distances, larger = point_distances(pairing, segments, None)
    comm = link.sides.V.mesh.comm
    farthest, share = maximum(
        comm, distances.max(initial=0.0), (distances / larger).max(initial=0.0)
    )
    all_around = find_coverage(pairing, everything, *node_weights(pairing, everything)).faces
    count = comm.allreduce(int((all_around & ~link.coupling.coverage.faces).sum()))
    return TieReach(float(farthest), float(share), count)


def _count_unheld(link: Link) -> int:
    """Number of slave facets without a multiplier that meet several master facets; collective."""
    if not link.pairing:
        return 0
    segments = link.mortar[1].segments
    bare = link.prescribed_facets()
    met = np.unique(np.column_stack([segments.slave, segments.master]), axis=0)[:, 0]
    bare &= np.bincount(met, minlength=len(bare)) > 1
    return int(link.sides.V.mesh.comm.allreduce(int(bare.sum())))


def warn(link: Link, found: InterfaceAudit, u: fem.Function | None) -> list[str]:
    """Warnings about an interface, coupled at a displacement; collective."""
    own = _warnings_on_reach(link, found.reach) if found.reach is not None else []
    return [*_warnings(found), *own, *warnings_on_straight_facets(link, u), *_mirrors(link)]


def reach_hint(link: Link) -> str:
    """Remedy for a body that a tie does not reach, or ""."""
    reach = _measure_reach(link)
    if reach is None or not reach.beyond:
        return ""
    return f"; {link.interface} does not reach {reach.beyond} slave nodes: {_remedy(link)}"


def _remedy(link: Link) -> str:
    given = "Tie(..., within=)" if link.interface.within is None else "within="
    return f"say how far it shall reach, {given}, or mark only what belongs together"


def _warnings_on_reach(link: Link, reach: TieReach) -> list[str]:
    plain = np.tan(np.radians(link.interface.feature_angle / 4))
    told = []
    if reach.share > plain:
        told.append(
            f"what is tied is up to {reach.farthest:.3g} apart, {reach.share:.2g} of a facet"
        )
    if reach.beyond:
        told.append(
            f"{reach.beyond} slave nodes face the master from more than half a facet farther than "
            "where the sides are nearest, and are not tied"
        )
    if link.interface.within is not None or not told:
        return []
    return [f"{link.interface}: {', and '.join(told)}; {_remedy(link)}"]


def _warnings(i: InterfaceAudit) -> list[str]:
    warnings = []
    if i.kept_nodes == 0 and not i.meets_itself:
        warnings.append(
            f"{i.name}: no slave node carries a multiplier, so that the interface has no effect; "
            "check the tags, or let the other side be the slave if Dirichlet data hold this one"
        )
    if i.edges is not None and i.edges.without_normal:
        warnings.append(
            f"{i.name}: {i.edges.without_normal} nodes have no normal, because the normals of "
            "their facets cancel; the gap there is that of the facets, not of the smooth surface"
        )
    if i.size_ratio > COARSE:
        warnings.append(
            f"{i.name}: slave facets are {i.size_ratio:.1f} times as long as master facets; "
            "let the finer side be the slave, unless it is much stiffer: pressures would oscillate"
        )
    if i.facing_away:
        warnings.append(
            f"{i.name}: {i.facing_away} slave facets face away from the master side; "
            "mark only facets that can touch"
        )
    if i.dirichlet_nodes:
        remedy = "let the other side be the slave, or prescribe fewer components there"
        if i.unheld:
            remedy = (
                f"{i.unheld} slave facets have no multiplier at all, and the master is not held to "
                "them: let the finer side be the slave, or mesh so that each of its facets has a "
                "free node"
            )
        warnings.append(
            f"{i.name}: at {i.dirichlet_nodes} slave nodes that face the master, Dirichlet data "
            "prescribe the motion that the interface would constrain, and take precedence; "
            f"{remedy}"
        )
    return warnings


def are_flat(link: Link, sides: tuple[SmoothSide, SmoothSide]) -> bool:
    """Whether the sagittas of both sides are round-off; collective."""
    highest = max(np.abs(side.sagitta).max(initial=0.0) for side in sides)
    length = mean_facet_length(link.sides.slave)
    return float(maximum(link.sides.V.mesh.comm, highest)[0]) <= HALF_OF_DIGITS * length


def warnings_on_straight_facets(link: Link, u: fem.Function | None = None) -> list[str]:
    """Warnings about second order on straight facets of curved sides; collective.

    Pressures oscillate there: on rings of 80 facets by .6 % (rms), of first order by .02 %.
    """
    slave, interface = link.sides.slave, link.interface
    if link.pairing is None or slave.curved or slave.element.degree == 1:
        return []
    if link.unilateral and not interface.smooth:
        return []
    pairing, segments = link.mortar[0], link.mortar[1].segments
    sides = find_smooth_sides(pairing, link.sides.fixed, interface.feature_angle, link.sides.shapes)
    if are_flat(link, sides):
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


def _mirrors(link: Link) -> list[str]:
    """Warn for each side whose normals at mirrors are bent by over 5 %; collective."""
    warnings, comm = [], link.sides.V.mesh.comm
    names = ("slave",) if link.sides.meet_themselves else ("slave", "master")
    judged = link.sides.judged
    for name, side, (mirrors, tilt) in zip(names, link.sides.surfaces, judged, strict=False):
        sines = np.where(mirrors, np.abs(tilt), 0.0).max(axis=1)[: side.owned]
        count = comm.allreduce(int((sines > 0.25 * SPOILT).sum()))
        angle = np.degrees(np.arcsin(min(maximum(comm, sines.max(initial=0.0))[0], 1.0)))
        if count:
            warnings.append(
                f"{link.interface}: at {count} nodes of its {name} side a support is taken for a "
                f"plane of symmetry, although facets there tell of an angle {angle:.2g} degrees "
                "off the right one: refine there, the more so if it is none"
            )
    return warnings
