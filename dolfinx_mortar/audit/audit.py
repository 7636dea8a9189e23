# SPDX-License-Identifier: MIT
"""Geometry audit before the first step."""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.audit.sides import InterfaceAudit, audit_sides, reach_hint, warn
from dolfinx_mortar.geometry.facets import facet_sizes, normals_at_nodes
from dolfinx_mortar.geometry.flat import near_others
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.interfaces.coupling import relative_motions
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.pretension import Bolt
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.mortar.facing_bodies import Skin, are_near, boxes_of, find_facing
from dolfinx_mortar.mortar.surface import (
    Surface,
    facets_at,
    nodal_normals,
)
from dolfinx_mortar.supports.bodies import Bodies, Motion, find_free, name_of
from dolfinx_mortar.supports.dirichlet import Dirichlet

PRETENSION_HINT = (
    ". A tie with a pretension does not hold its sides against its direction: supports, other ties "
    "or contacts have to, at both ends of the bolt"
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
            + "".join(map(reach_hint, links))
            + "".join(f". {one}" for one in empty)
        )
    for link in links:
        if link.pairing:
            _check_sides(link, bodies, x, increment)
    found = [audit_sides(link, x) for link in links]
    warnings = list(system.present.claims.notes) + empty
    if by_contact:
        warnings.append(
            f"contact alone holds {'; '.join(by_contact)}: the loads must press the sides together"
        )
    for link, i in zip(links, found, strict=True):
        taken = None if link.interface.stays else at
        warnings += warn(link, i, taken)
        warnings += link.interface.warnings(link, x)
    warnings += warnings_on_neighbours(bodies, system, at)
    return Audit(bodies.count, found, by_contact, warnings)


def find_free_motions(
    bodies: Bodies,
    system: InterfaceSystem,
    supports: Dirichlet,
    springs: Callable[[PETSc.Vec], Floats],
) -> tuple[list[str], list[str]]:
    """Free rigid motions, and bodies restrained only by contact; collective."""
    contacts = [link.constrained_motion for link in system.unilateral]
    facets = [_facet_motion(link) for link in system.unilateral]
    held = _held_motions(system, supports, springs)
    loose, free = find_free(bodies, held, contacts, facets)
    parts = [part for motion in free for part in motion.split(" + ")] if contacts else []
    return loose, list(dict.fromkeys(part.partition(" of ")[2] for part in parts))


def _held_motions(
    system: InterfaceSystem, supports: Dirichlet, springs: Callable[[PETSc.Vec], Floats]
) -> list[Motion]:
    held: list[Motion] = [lambda v: v.array_r[supports.owned.ravel()], springs]
    for link in system.links:
        if not link.unilateral:
            bolt = _bolt(link)
            held.append(link.constrained_motion if bolt is None else _held_but(link, bolt.axis))
    return held


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
    """Relative motion within half the angle of facet to nodal normals; collective."""
    comm = link.sides.V.mesh.comm
    edge = link.interface.feature_angle
    angle = max(facet_angle(side, edge, comm) for side in link.sides.surfaces)
    kept = link.coupling.directions[:, 0]
    normals = link.coupling.normals[kept]

    def motion(v: PETSc.Vec) -> Floats:
        relative = relative_motions(link, v)[0, kept]
        along = (relative * normals).sum(axis=1, keepdims=True)
        return np.asarray(0.5 * angle * (relative - along * normals))

    return motion


def facet_angle(surface: Surface, feature_angle: float, comm: MPI.Comm) -> float:
    """Rms angle between facet and nodal normals at X, without sharp edges; collective."""
    across = normals_at_nodes(facets_at(surface, surface.X))
    at_nodes = nodal_normals(surface, surface.X)[surface.facets]
    cosine = np.einsum("mki,mki->mk", across, at_nodes)
    sine2 = np.clip(1.0 - cosine[cosine > np.cos(np.radians(feature_angle / 2))] ** 2, 0.0, 1.0)
    sine2[sine2 < ROUND_OFF] = 0.0
    total = comm.allreduce(np.array([sine2.sum(), float(sine2.size)]), op=MPI.SUM)
    return float(np.arcsin(np.sqrt(total[0] / max(total[1], 1.0))))


def _check_sides(link: Link, bodies: Bodies, x: PETSc.Vec, increment: float) -> None:
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


def warnings_on_neighbours(
    bodies: Bodies, system: InterfaceSystem, at: fem.Function | None
) -> list[str]:
    """Warning for each near pair (`find_pairs`) without an interface; collective."""
    coupled = _coupled(bodies, system)
    if (coupled | np.eye(bodies.count, dtype=bool)).all():
        return []
    comm, facets = bodies.V.mesh.comm, system.boundary.at(at)
    part = bodies.of_cells[system.boundary.cells].astype(np.int64)
    largest = comm.allreduce(float(facet_sizes(facets.x).max(initial=0.0)), op=MPI.MAX)
    boxes = boxes_of(comm, facets.x, part, bodies.count)
    boxes += np.array([-largest, largest])[:, None]
    skin = Skin(facets, part, np.zeros((len(part), 0), dtype=np.int64))
    found = find_facing(comm, skin, near_others(facets.x, part, boxes))
    found = found[are_near(found, None)]
    least = np.full(coupled.shape, np.inf)
    np.minimum.at(least, tuple(np.sort(found.part, axis=1).T), found.distance)
    comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
    near = zip(*np.nonzero(np.isfinite(least) & ~coupled), strict=True)
    return [_warning(bodies, pair, float(least[pair])) for pair in near]


def _coupled(bodies: Bodies, system: InterfaceSystem) -> Bools:
    """Mask (bodies, bodies) of coupled bodies; collective."""
    on = np.zeros((2, len(system.sides), bodies.count))
    for k, sides in enumerate(system.sides):
        if sides.master is not None:
            for at, mark in zip(on, (sides.on_slave, sides.on_master), strict=True):
                at[k, bodies.label[mark[: len(bodies.label)]]] = 1.0
    slave, master = bodies.V.mesh.comm.allreduce(on)
    return np.asarray((slave.T @ master + master.T @ slave) > 0.0)


def _warning(bodies: Bodies, pair: tuple[int, ...], distance: float) -> str:
    who = " and ".join(name_of(bodies, [k]) for k in pair)
    how = f"are {distance:.3g} apart" if distance >= 0.0 else f"overlap by {-distance:.3g}"
    return (
        f"{who} {how}, and no interface couples them: give them a Contact if they "
        "can touch (dm.find_pairs proposes one)"
    )
