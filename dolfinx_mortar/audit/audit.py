# SPDX-License-Identifier: MIT
"""Geometry audit before the first step: free motions, counts and checks of interfaces."""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Floats
from dolfinx_mortar.geometry.facets import Facets, facet_normals, facet_sizes, normals_at_nodes
from dolfinx_mortar.geometry.segments import FACING
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.interfaces.coupling import relative_motions
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.interfaces.tie import Bolt
from dolfinx_mortar.mortar.curvature_correction import SmoothSide, find_parting, find_smooth_sides
from dolfinx_mortar.mortar.duals import find_coverage, node_weights
from dolfinx_mortar.mortar.facing_bodies import Skin, are_near, find_facing
from dolfinx_mortar.mortar.integrals import find_segments, point_distances
from dolfinx_mortar.mortar.pairing import Pairing
from dolfinx_mortar.mortar.surface import facets_at, mean_facet_length, nodal_normals
from dolfinx_mortar.solid.supports import Bodies, Dirichlet, Motion, bodies_of, find_free, name_of

# Ratio of slave to master facets without a warning, half of that where the peak of a disc on a
# block is still right to .7 % (6 % at 8).
COARSE = 2.0
# Ratio of sagitta error to contact forces with a warning: the peak pressure of a pin is wrong by 5
# % below it, by 30 % and more from 0.3 on.
SPOILT = 0.2
# Relative curvature of closely fitting sides over the larger one: peak pressures are up to 25 % too
# high above it.
CLOSE = 0.5
Check = tuple[bool, str]  # whether to warn, and the warning
PRETENSION_HINT = (
    ". A tie with a pretension does not hold its sides against its direction: supports, other ties "
    "or contacts have to, at both ends of the bolt"
)


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


@dataclass(frozen=True)
class Audit:
    """Results of the audit."""

    bodies: int
    interfaces: list[InterfaceAudit]
    held_by_contact: list[str]
    warnings: list[str]

    def __str__(self) -> str:
        lines = [f"{self.bodies} bodies, {len(self.interfaces)} interfaces"]
        lines += [str(i) for i in self.interfaces]
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings])

    __repr__ = __str__


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
    """Audit bodies and paired interfaces; a ValueError for a body that can move freely; collective.

    `x` (n,) is X + u, `at` the displacement of the contacts (None for X), `springs` the relative
    resistance of the potential to a motion, `increment` the largest prescribed one.
    """
    links, empty = system.links, supports.warnings()
    loose, by_contact = find_free_motions(bodies, system, supports, springs)
    if loose:
        raise ValueError(
            "bcs, interfaces: nothing holds the bodies against "
            + "; ".join(loose)
            + ". Prescribe these motions (bcs), or check slave and master tags"
            + (PRETENSION_HINT if any(_bolt(link) is not None for link in links) else "")
            + "".join(map(_reach_hint, links))
            + "".join(f". {one}" for one in empty)
        )
    found = [_audit_sides(link, x) for link in links]
    warnings = list(system.present.claims.notes) + empty
    if by_contact:
        warnings.append(
            f"contact alone holds {'; '.join(by_contact)}: the loads must press the sides together"
        )
    for link, i in zip(links, found, strict=True):
        if link.pairing:
            _check_sides(link, i, float(bodies.radius.max()), increment)
        warnings += _warnings(link, i, None if link.interface.stays else at)
        warnings += link.interface.warnings(link, x)
    warnings += _warnings_on_neighbours(bodies, system, at)
    return Audit(bodies.count, found, by_contact, warnings)


def find_free_motions(
    bodies: Bodies,
    system: InterfaceSystem,
    supports: Dirichlet,
    springs: Callable[[PETSc.Vec], Floats],
) -> tuple[list[str], list[str]]:
    """Free rigid motions, and bodies restrained only by contact; collective."""
    held: list[Motion] = [lambda v: v.array_r[supports.owned.ravel()], springs]
    for link in system.links:
        if not link.unilateral:
            bolt = _bolt(link)
            held.append(link.constrained_motion if bolt is None else _held_but(link, bolt.axis))
    contacts = [link.constrained_motion for link in system.unilateral]
    facets = [_facet_motion(link) for link in system.unilateral]
    loose, free = find_free(bodies, held, contacts, facets)
    parts = [part for motion in free for part in motion.split(" + ")] if contacts else []
    return loose, list(dict.fromkeys(part.partition(" of ")[2] for part in parts))


def _bolt(link: Link) -> Bolt | None:
    bolt = link.interface.driven()
    return bolt if isinstance(bolt, Bolt) else None


def _held_but(link: Link, axis: Floats) -> Motion:
    """Motion resisted by a tie with free overlap along an axis (d,); collective."""
    moved = link.spread(np.tile(axis, (len(link.nodes), 1)))
    e, comm = link.constrained_motion(moved), moved.comm.tompi4py()
    size = comm.allreduce(float(e @ e))

    def motion(v: PETSc.Vec) -> Floats:
        w = link.constrained_motion(v)
        return np.asarray(w - e * comm.allreduce(float(e @ w)) / size) if size > 0.0 else w

    return motion


def _facet_motion(link: Link) -> Motion:
    """Relative motion within half the rms angle of facet to nodal normals at X; collective."""
    comm, angle = link.sides.V.mesh.comm, 0.0
    for side in link.sides.surfaces:
        across = normals_at_nodes(facets_at(side, side.X))
        cosine = np.einsum("mki,mki->mk", across, nodal_normals(side, side.X)[side.facets])
        smooth = cosine > np.cos(np.radians(link.interface.feature_angle / 2))
        sine2 = np.clip(1.0 - cosine[smooth] ** 2, 0.0, 1.0)
        sine2[sine2 < ROUND_OFF] = 0.0
        total, count = comm.allreduce(np.array([sine2.sum(), float(sine2.size)]), op=MPI.SUM)
        angle = max(angle, float(np.arcsin(np.sqrt(total / max(count, 1.0)))))
    kept = link.coupling.directions[:, 0]
    normals = link.coupling.normals[kept]

    def motion(v: PETSc.Vec) -> Floats:
        relative = relative_motions(link, v)[0, kept]
        along = (relative * normals).sum(axis=1, keepdims=True)
        return 0.5 * angle * (relative - along * normals)

    return motion


def _audit_sides(link: Link, x: PETSc.Vec) -> InterfaceAudit:
    """Count over the sides of one interface; collective."""
    sides, pairing, kept = link.sides, link.pairing, link.coupling.kept.any(axis=1)
    comm, itself = sides.V.mesh.comm, sides.meet_themselves
    slaves, masters = (len(side.facets) for side in (sides.slave, sides.master or sides.slave))
    if pairing is not None and pairing.roles is not None:
        seen = np.unique(pairing.roles.seen // max(len(pairing.roles.copies), 1))
        slaves = int(pairing.roles.slave[seen].sum())
        masters = len(seen) - slaves
    unheld = link.prescribed_facets() if pairing else np.zeros(0, dtype=bool)
    if pairing:
        segments = link.mortar[1].segments
        met = np.unique(np.column_stack([segments.slave, segments.master]), axis=0)[:, 0]
        unheld &= np.bincount(met, minlength=len(unheld)) > 1
    covered = link.coupling.coverage.faces | kept
    on_edges = np.sum([side.edges for side in link.pattern.smooth or ()], axis=0)
    own = {
        "slave_facets": slaves,
        "master_facets": masters if sides.master else 0,
        "slave_nodes": len(link.nodes),
        "kept_nodes": kept.sum(),
        "uncovered_nodes": (~covered).sum(),
        "removed_nodes": (covered & ~kept).sum(),
        "dirichlet_nodes": (link.prescribed & ~link.banned[link.nodes]).sum(),
        "facing_away": _count_facing_away(pairing) if pairing and not itself else 0,
        "unheld": unheld.sum(),
    }
    counts = dict(zip(own, comm.allreduce(np.array([*own.values()])).tolist(), strict=True))
    edges = None
    if link.pattern.smooth and not sides.slave.curved:
        nodes, without = comm.allreduce(on_edges)
        edges = Edges(link.interface.feature_angle, int(nodes), int(without))
    lengths, gap = [mean_facet_length(side) for side in sides.surfaces], link.gaps(x)[kept]
    extent = np.abs(sides.V.mesh.geometry.x).max(initial=0.0)
    both = (-gap).max(initial=-np.inf), gap.max(initial=-np.inf)
    *ends, extent = maximum(comm, *both, extent)
    # round-off of coordinates is no gap
    least = ROUND_OFF * max(lengths[0], float(extent))
    overlap, largest = (0.0 if abs(end) < least or np.isinf(end) else float(end) for end in ends)
    return InterfaceAudit(
        name=repr(link.interface),
        size_ratio=float(lengths[0] / lengths[-1]),
        least_gap=np.nan if sides.hold else -overlap,
        largest_gap=np.nan if sides.hold else largest,
        edges=edges,
        reach=_measure_reach(link),
        meets_itself=itself,
        **counts,
    )


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


def _check_sides(link: Link, found: InterfaceAudit, radius: float, increment: float) -> None:
    """Raise a ValueError for sides of one surface, and for sides that never meet; collective."""
    joined, facing, reached = maximum(
        link.sides.V.mesh.comm,
        (link.sides.on_slave & link.sides.on_master).any(),
        float(len(link.mortar[0].pairs)),
        link.coupling.coverage.reached.any(),
    )
    deep = -found.least_gap
    if joined and not found.meets_itself and (deep > radius or (facing and not reached)):
        how_deep = f", {deep:.3g} deep" if found.kept_nodes else ""
        raise ValueError(
            f"{found.name}: its sides are parts of one surface "
            f"that meets itself through its body{how_deep}; mark only the parts that can touch"
        )
    everywhere = not link.unilateral and link.interface.within == np.inf  # a periodic cell's
    if -found.largest_gap > radius + 2.0 * increment and not everywhere:
        raise ValueError(
            f"{found.name}: its sides can never meet: all slave "
            f"nodes lie at least {-found.largest_gap:.3g} beyond the master side; check the tags"
        )


def _reach_hint(link: Link) -> str:
    """Remedy for a body that a tie does not reach, or ""."""
    reach = _measure_reach(link)
    if reach is None or not reach.beyond:
        return ""
    return f"; {link.interface} does not reach {reach.beyond} slave nodes: {_remedy(link)}"


def _remedy(link: Link) -> str:
    given = "Tie(..., within=)" if link.interface.within is None else "within="
    return f"say how far it shall reach, {given}, or mark only what belongs together"


def _warnings(link: Link, i: InterfaceAudit, u: fem.Function | None) -> list[str]:
    """Warnings about an interface, coupled at a displacement; collective."""
    remedy = "let the other side be the slave, or prescribe fewer components there"
    if i.unheld:
        remedy = (
            f"{i.unheld} slave facets have no multiplier at all, and the master is not held to "
            "them: let the finer side be the slave, or mesh so that each of its facets has a free "
            "node"
        )
    checks = [
        (
            i.kept_nodes == 0 and not i.meets_itself,
            "no slave node carries a multiplier, so that the interface has no effect; check the "
            "tags, or let the other side be the slave if Dirichlet data hold this one",
        ),
        (
            i.edges is not None and i.edges.without_normal > 0,
            f"{i.edges and i.edges.without_normal} nodes have no normal, because the normals of "
            "their facets cancel; the gap there is that of the facets, not of the smooth surface",
        ),
        (
            i.size_ratio > COARSE,
            f"slave facets are {i.size_ratio:.1f} times as long as master facets; let the finer "
            "side be the slave, unless it is much stiffer: pressures would oscillate",
        ),
        (
            i.facing_away > 0,
            f"{i.facing_away} slave facets face away from the master side; mark only facets that "
            "can touch",
        ),
        (
            i.dirichlet_nodes > 0,
            f"at {i.dirichlet_nodes} slave nodes that face the master, Dirichlet data prescribe "
            f"the motion that the interface would constrain, and take precedence; {remedy}",
        ),
        *_checks_of_reach(link, i.reach),
        *_checks_of_curvature(link, u),
        *_checks_of_mirrors(link),
    ]
    return [f"{i.name}: {warning}" for holds, warning in checks if holds]


def _checks_of_reach(link: Link, reach: TieReach | None) -> list[Check]:
    if reach is None or link.interface.within is not None:
        return []
    apart = f"what is tied is up to {reach.farthest:.3g} apart, {reach.share:.2g} of a facet"
    beyond = (
        f"{reach.beyond} slave nodes face the master from more than half a facet farther than "
        "where the sides are nearest, and are not tied"
    )
    far = reach.share > np.tan(np.radians(link.interface.feature_angle / 4))
    told = [apart] * bool(far) + [beyond] * (reach.beyond > 0)
    return [(bool(told), f"{', and '.join(told)}; {_remedy(link)}")]


def are_flat(link: Link, sides: tuple[SmoothSide, SmoothSide]) -> bool:
    """Whether the sagittas of both sides are round-off; collective."""
    highest = max(np.abs(side.sagitta).max(initial=0.0) for side in sides)
    length = mean_facet_length(link.sides.slave)
    return float(maximum(link.sides.V.mesh.comm, highest)[0]) <= HALF_OF_DIGITS * length


def _checks_of_curvature(link: Link, u: fem.Function | None) -> list[Check]:
    """Second order on straight facets of curved sides; collective.

    Pressures oscillate there: on rings of 80 facets by .6 % (rms), of first order by .02 %.
    """
    slave, interface = link.sides.slave, link.interface
    if link.pairing is None or slave.curved or slave.element.degree == 1:
        return []
    if link.unilateral and not interface.smooth:
        return []
    pairing, segments = link.mortar[0], link.mortar[1].segments
    sides = find_smooth_sides(pairing, link.sides.fixed, interface.feature_angle, link.sides.shapes)
    spoilt = not are_flat(link, sides)
    where, how = "curved sides", "of ties of degree 2 scatter by some per cent on any mesh"
    if link.unilateral:
        spoilt = spoilt and find_parting(pairing, segments, u, sides) < CLOSE
        where, how = "curved sides that fit closely", "of degree 2 are far off on coarse meshes"
    told = (
        f"straight facets stand for {where}, where pressures {how}: take curved cells (Gmsh: "
        "mesh.setOrder(2)) or displacements of degree 1"
    )
    return [(spoilt, told)]


def _checks_of_mirrors(link: Link) -> list[Check]:
    """Sides whose normals at mirrors are bent by over 5 %; collective."""
    checks, comm = [], link.sides.V.mesh.comm
    names = ("slave",) if link.sides.meet_themselves else ("slave", "master")
    judged = link.sides.judged
    for name, side, (mirrors, tilt) in zip(names, link.sides.surfaces, judged, strict=False):
        sines = np.where(mirrors, np.abs(tilt), 0.0).max(axis=1)[: side.owned]
        count = comm.allreduce(int((sines > 0.25 * SPOILT).sum()))
        angle = np.degrees(np.arcsin(min(maximum(comm, sines.max(initial=0.0))[0], 1.0)))
        told = (
            f"at {count} nodes of its {name} side a support is taken for a plane of symmetry, "
            f"although facets there tell of an angle {angle:.2g} degrees off the right one: refine "
            "there, the more so if it is none"
        )
        checks.append((count > 0, told))
    return checks


def _warnings_on_neighbours(
    bodies: Bodies, system: InterfaceSystem, at: fem.Function | None
) -> list[str]:
    """Warning for each near pair (`find_pairs`) without an interface; collective."""
    sides = [side for side in system.sides if side.master is not None]
    slave = bodies_of(bodies, [side.on_slave for side in sides])
    touched = slave.T @ bodies_of(bodies, [side.on_master for side in sides])
    coupled = (touched + touched.T) > 0.0
    if (coupled | np.eye(bodies.count, dtype=bool)).all():
        return []
    comm, facets = bodies.V.mesh.comm, system.boundary.at(at)
    part = bodies.of_cells[system.boundary.cells].astype(np.int64)
    found = find_facing(comm, Skin(facets, part, np.zeros((len(part), 0), dtype=np.int64)))
    found = found[are_near(found, None)]
    least = np.full(coupled.shape, np.inf)
    np.minimum.at(least, tuple(np.sort(found.part, axis=1).T), found.distance)
    comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
    near = zip(*np.nonzero(np.isfinite(least) & ~coupled), strict=True)
    warnings = []
    for pair in near:
        who, apart = " and ".join(name_of(bodies, [k]) for k in pair), float(least[pair])
        how = f"are {apart:.3g} apart" if apart >= 0.0 else f"overlap by {-apart:.3g}"
        warnings.append(
            f"{who} {how}, and no interface couples them: give them a Contact if they can touch "
            "(dm.find_pairs proposes one)"
        )
    return warnings
