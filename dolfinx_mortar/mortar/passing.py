# SPDX-License-Identifier: MIT
"""Whether one side has passed through the other in a step, so that contact no longer finds it.

Facets deeper than a part of the thinner body are no partners (`THROUGH`), and there are none beyond
an edge, so a side that moves far enough in one step has no partners at its end. The test is on the
middle of the body behind each facet: as long as the sides have not passed through each other, it
does not lie in the other body.
"""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, facet_normals
from dolfinx_mortar.geometry.sweep import find_passing, flat_parts
from dolfinx_mortar.geometry.turning import best_motion, path, rigid_sums, times_of
from dolfinx_mortar.mortar.pairing import THROUGH
from dolfinx_mortar.mortar.surface import Surface, coordinates, facets_at, thickness_behind


@dataclass(frozen=True)
class Middles:
    """The middle of the bodies behind the facets of a surface."""

    surface: Surface
    depth: Floats  # (m,) its distance from each facet at X


def find_middles(surface: Surface, body_of: Ints, skin: Facets, bodies: Ints) -> Middles:
    """Return the middles of the bodies behind a surface, by all their exterior facets; collective.

    Bodies are measured one by one, since they may overlap.

    Args:
        body_of: number (m,) of the body behind each of its facets.
        skin: exterior facets of this rank.
        bodies: number of the body of each of those.
    """
    comm, facets = surface.V.mesh.comm, facets_at(surface, surface.X)
    depth = np.full(len(body_of), np.inf)
    for body in np.unique(np.concatenate(comm.allgather(np.unique(body_of)))):
        mine = np.flatnonzero(body_of == body)
        thickness = thickness_behind(facets[mine], skin[np.flatnonzero(bodies == body)], comm)
        depth[mine] = THROUGH * thickness
    return Middles(surface, depth)


@dataclass(frozen=True)
class Passing:
    """What has passed through a surface, over all ranks."""

    surface: Surface  # through which
    count: int  # facets of the other side behind which the middle of the body has passed
    place: tuple[float, ...]  # of one of these facets, at the start
    depth: float  # distance of the middle from that facet


def is_far(slave: Middles, master: Middles, before: Floats, now: Floats) -> bool:
    """Tell whether two sides have moved so far that one may have passed through the other.

    That takes a relative displacement of the depth of the least middle, as sides touch at most at
    the start of a step. No facets are looked at; collective.

    Args:
        slave: one side.
        master: the other side.
        before: displacements (owned nodes, d) at the start of the step.
        now: those at its end.
    """
    sides = slave.surface, master.surface
    nodes = np.concatenate([side.nodes[: side.owned] for side in sides])
    least_depth = min(side.depth.min(initial=np.inf) for side in (slave, master))
    moved = now[nodes] - before[nodes]
    most, least = moved.max(axis=0, initial=-np.inf), moved.min(axis=0, initial=np.inf)
    found = maximum(sides[0].V.mesh.comm, -least_depth, *most, *-least)
    extent = found[1:].reshape(2, -1).sum(axis=0)
    return bool(np.linalg.norm(extent) >= -found[0])


def find_passed(
    slave: Middles, master: Middles, before: fem.Function, now: fem.Function
) -> Passing | None:
    """Return the side through which the other one has passed, None if neither; collective.

    All ranks get all facets of a side: call `is_far` first.

    Args:
        slave: one side.
        master: the other side.
        before: displacement at the start of the step.
        now: displacement at its end.
    """
    found = _passed(slave, master.surface, before, now)
    return _passed(master, slave.surface, before, now) if found is None else found


def _passed(
    side: Middles, other: Surface, before: fem.Function, now: fem.Function
) -> Passing | None:
    """Return how middles of a side have passed through another surface; collective."""
    own, comm = side.surface, other.V.mesh.comm
    finite = np.isfinite(side.depth)
    facets = [facets_at(own, coordinates(own, u)) for u in (before, now)]
    depth, corners = side.depth[finite], np.array(own.element.vertices)
    faces = [f.x[finite][:, corners].mean(axis=1) for f in facets]
    middles = [
        x - depth[:, None] * facet_normals(f[finite]) for x, f in zip(faces, facets, strict=True)
    ]
    parts = [flat_parts(facets_at(other, coordinates(other, u))) for u in (before, now)]
    start, end = (np.concatenate(comm.allgather(part)) for part in parts)
    d, origin = start.shape[2], start.mean(axis=(0, 1))  # the sums are made near it
    frame = best_motion(rigid_sums(*((x - origin).reshape(-1, d) for x in (start, end))))
    sums = rigid_sums(*((f.x - origin).reshape(-1, d) for f in facets))
    motion = best_motion(comm.allreduce(sums, op=MPI.SUM)).seen_from(frame)
    times = times_of([motion])
    ways = path(motion, times, middles[0] - origin, frame.back(middles[1] - origin))
    back = frame.back(end - origin)
    others = [(1.0 - t) * (start - origin) + t * back for t in times]
    found = [
        find_passing((ways[k], ways[k + 1]), (others[k], others[k + 1]))
        for k in range(len(times) - 1)
    ]
    passed = np.unique(np.concatenate(found))
    count = comm.allreduce(len(passed), op=MPI.SUM)
    if not count:
        return None
    places = comm.allgather([(*faces[0][k].tolist(), float(depth[k])) for k in passed[:1]])
    *place, deep = min(found[0] for found in places if found)
    return Passing(other, count, tuple(place), deep)
