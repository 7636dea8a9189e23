# SPDX-License-Identifier: MIT
"""The geometry audit before the first step: errors and warnings about sides and bodies."""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.spatial import cKDTree

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.audit.doubtful_mirrors import warnings_on_mirrors
from dolfinx_mortar.audit.far_ties import TieReach, measure_reach
from dolfinx_mortar.audit.neighbours import warnings_on_neighbours
from dolfinx_mortar.audit.stand_off import warnings_on_straight_facets
from dolfinx_mortar.audit.unheld import Unheld, find_unheld
from dolfinx_mortar.geometry.facets import Facets, facet_normals, facet_sizes, normals_at_nodes
from dolfinx_mortar.geometry.segments import FACING
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.interfaces.coupling import relative_motions
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.pretension import Bolt
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.mortar.pairing import Pairing
from dolfinx_mortar.mortar.surface import (
    Surface,
    facets_at,
    mean_facet_length,
    nodal_normals,
)
from dolfinx_mortar.supports.bodies import Bodies, Motion, find_free
from dolfinx_mortar.supports.dirichlet import Dirichlet

# A slave facet this many times longer than the master's makes the contact pressure coarse. A disc
# on a block, moduli 1:1 to 1:1000, either one meshed coarser: with the coarser side as slave forces
# are those of fine meshes to .3 % up to 4 times and peaks of pressure to .7 %, at 6 times to 1.7
# and 1.6 %, at 8 times peaks to 6 %, at 12 times to 11 % and forces to 3 %, with 3 to 5 nodes. So 2
# leaves a factor of two for patches of fewer facets.
COARSE = 2.0
# Added to the message about unconstrained bodies where the overlap of a tie is free
PRETENSION_HINT = (
    ". A tie with a pretension does not hold its sides against its direction: supports, other ties "
    "or contacts have to, at both ends of the bolt"
)


@dataclass(frozen=True)
class Edges:
    """Where smooth surfaces keep their facets: nodes of both sides, all ranks."""

    feature_angle: float  # degrees between facets from which on they meet in an edge
    nodes: int  # on edges
    without_normal: int  # of these: at a cusp, or between opposite facets

    def __str__(self) -> str:
        return f"{self.nodes} nodes on edges of {self.feature_angle:g} degrees or more"


@dataclass(frozen=True)
class InterfaceAudit:
    """Counts over one interface, all ranks."""

    name: str
    slave_facets: int
    master_facets: int
    slave_nodes: int
    kept_nodes: int  # carry a multiplier
    uncovered_nodes: int  # face no master: gap not-a-number, "facing" 0
    removed_nodes: int  # face one, but without a multiplier (Dirichlet, claims)
    dirichlet_nodes: int  # face one, but Dirichlet data leave no direction to act in
    facing_away: int  # slave facets that touch master facets, but do not face them
    size_ratio: float  # mean slave facet length over mean master facet length; 1 without a master
    least_gap: float  # smallest distance of a kept node to the master, negative in an overlap
    largest_gap: float  # both not-a-number where an interface has neither a master nor a gap
    edges: Edges | None = None  # of smooth surfaces
    reach: TieReach | None = None  # of ties
    unheld: Unheld | None = None  # where Dirichlet data leave no multiplier
    meets_itself: bool = False  # one surface, divided into slaves and masters where it is near

    def __str__(self) -> str:
        gap = f", gaps from {self.least_gap:.3g} to {self.largest_gap:.3g}"
        if np.isnan(self.least_gap):
            gap = ""
        elif self.least_gap < 0.0:
            gap += f" (overlap {-self.least_gap:.3g})"
        return (
            f"{self.name}: {self.slave_facets} slave and {self.master_facets} master facets"
            f"{' near each other' if self.meets_itself else ''}, "
            f"{self.kept_nodes} of {self.slave_nodes} slave nodes carry a multiplier, "
            f"{self.uncovered_nodes} face no master, {self.removed_nodes} removed{gap}"
            + "".join(f", {part}" for part in (self.edges, self.reach) if part)
        )


@dataclass(frozen=True)
class Audit:
    """Results of the audit."""

    bodies: int
    interfaces: list[InterfaceAudit]
    held_by_contact: list[str]  # names of bodies that nothing but contact holds
    warnings: list[str]

    def __str__(self) -> str:
        lines = [f"{self.bodies} bodies, {len(self.interfaces)} interfaces"]
        lines += [str(i) for i in self.interfaces]
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings])

    __repr__ = __str__  # what notebooks show


def create_audit(
    bodies: Bodies,
    system: InterfaceSystem,
    supports: Dirichlet,
    x: PETSc.Vec,
    springs: Callable[[PETSc.Vec], Floats],
    *,
    at: fem.Function | None,
    increment: float,
) -> Audit:
    """Audit bodies and interfaces whose pairings exist; collective.

    Args:
        x: (n,) present coordinates X + u.
        springs: resistance of the potential to a motion, relative to the stiffest.
        at: displacement at which contacts are taken, None for X.
        increment: largest prescribed increment of the step that follows, 0 if not known.

    Raises:
        ValueError: if a body can move rigidly without any resistance.
    """
    links, empty = system.links, supports.warnings()
    loose, by_contact = find_free_motions(bodies, system, supports, springs)
    if loose:
        reaches = [reach for link in links if (reach := measure_reach(link))]
        raise ValueError(
            "bcs, interfaces: nothing holds the bodies against "
            + "; ".join(loose)
            + ". Prescribe these motions (bcs), or check slave and master tags"
            + (PRETENSION_HINT if any(_bolt(link) is not None for link in links) else "")
            + "".join(reach.hint for reach in reaches)
            + "".join(f". {one}" for one in empty)
        )
    for link in links:
        if link.pairing:
            _check_sides(link, bodies, x, increment)
    found = [_audit(link, x) for link in links]
    warnings = list(system.notes) + empty
    if by_contact:
        warnings.append(
            f"contact alone holds {'; '.join(by_contact)}: the loads must press the sides together"
        )
    for link, i in zip(links, found, strict=True):
        warnings += _warnings(i)
        taken = None if link.interface.stays else at
        warnings += warnings_on_straight_facets(link, taken) + warnings_on_mirrors(link)
        warnings += link.interface.warnings(link, x)
    warnings += warnings_on_neighbours(bodies, system, at)
    return Audit(bodies.count, found, by_contact, warnings)


def find_free_motions(
    bodies: Bodies,
    system: InterfaceSystem,
    supports: Dirichlet,
    springs: Callable[[PETSc.Vec], Floats],
) -> tuple[list[str], list[str]]:
    """Return what may move rigidly, see `create_audit`; collective.

    A tie with a pretension resists all but the overlap of its sides.

    Returns:
        The names of the rigid motions that nothing resists, and those of the bodies that contact
        alone holds.
    """
    contacts = [link.constrained_motion for link in system.unilateral]
    facets = [_facet_motion(link) for link in system.unilateral]
    held = _held_motions(system, supports, springs)
    loose, free = find_free(bodies, held, contacts, facets)
    parts = [part for motion in free for part in motion.split(" + ")] if contacts else []
    return loose, list(dict.fromkeys(part.partition(" of ")[2] for part in parts))


def _held_motions(
    system: InterfaceSystem, supports: Dirichlet, springs: Callable[[PETSc.Vec], Floats]
) -> list[Motion]:
    """Return the motions that supports, springs and ties resist."""
    held: list[Motion] = [lambda v: v.array_r[supports.owned.ravel()], springs]
    for link in system.links:
        bolt = _bolt(link)
        held.append(link.held_motion if bolt is None else _held_but(link, bolt.axis))
    return held


def _bolt(link: Link) -> Bolt | None:
    """Return the overlap that a pretension drives, None for none."""
    bolt = link.interface.driven()
    return bolt if isinstance(bolt, Bolt) else None


def _held_but(link: Link, axis: Floats) -> Motion:
    """Return the motion that a tie resists whose overlap along an axis (d,) is free; collective."""
    moved = link.spread(np.tile(axis, (len(link.nodes), 1)))
    e, comm = link.constrained_motion(moved), moved.comm.tompi4py()
    size = comm.allreduce(float(e @ e))

    def motion(v: PETSc.Vec) -> Floats:
        w = link.constrained_motion(v)
        return np.asarray(w - e * comm.allreduce(float(e @ w)) / size) if size > 0.0 else w

    return motion


def _facet_motion(link: Link) -> Motion:
    """Return the part of a relative motion that is within the error of facet normals; collective.

    Averaged normals of uneven facets are off those of the true side, at most by half the angle
    between facet and nodal normal in the mean (a quarter of the facets' unevenness of it on a
    circle): sliding along the side shows as much normal motion. Flat sides have no such part. The
    slips are vectors, for a length is not linear in the motion.
    """
    comm = link.sides.V.mesh.comm
    edge = link.interface.feature_angle
    angle = max(facet_angle(side, edge, comm) for side in link.sides.surfaces)
    kept = link.coupling.directions[:, 0]
    normals = link.coupling.normals[kept]

    def motion(v: PETSc.Vec) -> Floats:
        relative = relative_motions(link, v)[0, kept]  # contacts have one choice of nodes
        along = (relative * normals).sum(axis=1, keepdims=True)
        return np.asarray(0.5 * angle * (relative - along * normals))

    return motion


def facet_angle(surface: Surface, feature_angle: float, comm: MPI.Comm) -> float:
    """Return the root mean square angle between facet and nodal normals at X; collective.

    Without those at edges, where facets meet at the feature angle or more (degrees).
    """
    across = normals_at_nodes(facets_at(surface, surface.X))
    at_nodes = nodal_normals(surface, surface.X)[surface.facets]
    cosine = np.einsum("mki,mki->mk", across, at_nodes)
    sine2 = np.clip(1.0 - cosine[cosine > np.cos(np.radians(feature_angle / 2))] ** 2, 0.0, 1.0)
    sine2[sine2 < ROUND_OFF] = 0.0
    total = comm.allreduce(np.array([sine2.sum(), float(sine2.size)]), op=MPI.SUM)
    return float(np.arcsin(np.sqrt(total[0] / max(total[1], 1.0))))


def _warnings(i: InterfaceAudit) -> list[str]:
    """Return the warnings about an interface."""
    warnings = []
    if i.kept_nodes == 0 and not i.meets_itself:
        warnings.append(
            f"{i.name}: no slave node carries a multiplier, so that the interface has no effect; "
            "check the tags, or let the other side be the slave if Dirichlet data hold this one"
        )
    if i.reach is not None and i.reach.warning:
        warnings.append(i.reach.warning)
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
        if i.unheld is not None:
            remedy = (
                f"{i.unheld} have no multiplier at all, and the master is not held to them: let "
                "the finer side be the slave, or mesh so that each of its facets has a free node"
            )
        warnings.append(
            f"{i.name}: at {i.dirichlet_nodes} slave nodes that face the master, Dirichlet data "
            "prescribe the motion that the interface would constrain, and take precedence; "
            f"{remedy}"
        )
    return warnings


def _check_sides(link: Link, bodies: Bodies, x: PETSc.Vec, increment: float) -> None:
    """Raise a ValueError on all ranks if two sides face each other only through their bodies.

    That is so if every slave node is deeper inside the master body than any body is large, and
    deeper than the prescribed motions of both sides, for which smaller steps help; smaller overlaps
    are admissible. Where the two sides are parts of one surface, it is so as soon as a slave
    node lies that deep (faces of a crack share nodes, too, but do not overlap), or if all facets
    that face each other do so across the body.
    """
    interface, kept = link.interface, link.coupling.kept.all(axis=1)
    normal = -link.gaps(x)
    shallowest, deepest, some, joined, facing, reached = maximum(
        bodies.V.mesh.comm,
        (-normal[kept]).max(initial=-np.inf),
        normal[kept].max(initial=-np.inf),
        kept.any(),
        (link.sides.on_slave & link.sides.on_master).any(),
        float(len(link.mortar[0].pairs)),
        link.coupling.coverage.reached.any(),
    )
    parts = joined and not link.sides.meet_themselves
    if parts and (deepest > bodies.radius.max() or (facing and not reached)):
        how_deep = f", {deepest:.3g} deep" if some else ""
        raise ValueError(
            f"{interface}: its sides are parts of one surface "
            f"that meets itself through its body{how_deep}; mark only the parts that can touch"
        )
    if some and -shallowest > bodies.radius.max() + 2.0 * increment:
        raise ValueError(
            f"{interface}: its sides can never meet: all slave "
            f"nodes lie at least {-shallowest:.3g} beyond the master side; check the tags"
        )


def _audit(link: Link, x: PETSc.Vec) -> InterfaceAudit:
    """Count over the slave side of one interface; collective."""
    sides, kept = link.sides, link.coupling.kept.any(axis=1)
    covered = link.coupling.coverage.faces | kept
    gap = link.gaps(x)[kept]
    least, largest = maximum(
        sides.V.mesh.comm, (-gap).max(initial=-np.inf), gap.max(initial=-np.inf)
    )
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
    # what is round-off of the coordinates is no gap
    x = np.abs(sides.V.mesh.geometry.x).max(initial=0.0)
    size = ROUND_OFF * max(float(lengths[0]), float(maximum(sides.V.mesh.comm, x)[0]))
    if sides.hold:  # it holds nodes where they are
        least = largest = np.nan
    ends = [0.0 if abs(end) < size or np.isinf(end) else float(end) for end in (-least, largest)]
    edges = _edges(link) if link.pattern.smooth and not sides.slave.curved else None
    unheld = find_unheld(link)
    row = *map(int, counts), ratio, *ends, edges, measure_reach(link), unheld, itself
    return InterfaceAudit(repr(link.interface), *row)  # type: ignore[arg-type]


def _count_facets(link: Link) -> tuple[int, int]:
    """Return the numbers of slave and of master facets of this rank.

    Of a surface that meets itself, those that are near each other.
    """
    sides, pairing = link.sides, link.pairing
    if sides.master is None:
        return len(sides.slave.facets), 0
    if pairing is None or pairing.roles is None:
        return len(sides.slave.facets), len(sides.master.facets)
    seen = np.unique(pairing.roles.seen // max(len(pairing.roles.copies), 1))
    slaves = int(pairing.roles.slave[seen].sum())
    return slaves, len(seen) - slaves


def _edges(link: Link) -> Edges:
    """Count where smooth surfaces keep their facets; collective."""
    assert link.pattern.smooth is not None
    own = np.sum([side.edges for side in link.pattern.smooth], axis=0)
    nodes, without = link.sides.V.mesh.comm.allreduce(own)
    return Edges(link.interface.feature_angle, int(nodes), int(without))


def _count_facing_away(pairing: Pairing) -> int:
    """Return how many slave facets of this rank touch a master facet that looks the same way.

    "Touch" means that the nearest master facet is within one facet length at X. Facets at a right
    angle, around a corner, merely have no partners.
    """
    x_s = pairing.slave.X[pairing.slave.facets]
    x_m = pairing.master_X[pairing.master_facets]
    if len(x_s) == 0 or len(x_m) == 0:
        return 0
    distance, nearest = cKDTree(x_m.mean(axis=1)).query(x_s.mean(axis=1))
    n_s = facet_normals(Facets(pairing.slave.element, x_s))
    n_m = facet_normals(Facets(pairing.master.element, x_m))
    opposed = np.einsum("mi,mi->m", n_s, n_m[nearest])
    return int(((distance < facet_sizes(x_s)) & (opposed > FACING)).sum())
