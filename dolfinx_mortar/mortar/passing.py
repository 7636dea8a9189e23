# SPDX-License-Identifier: MIT
"""Whether one side has passed through the other in a step, so that contact no longer finds it.

Facets deeper than a part of the thinner body are no partners (`THROUGH`), and there are none beyond
an edge, so a side that moves far enough in one step has no partners at its end. The test is on the
middle of the body behind each facet: as long as the sides have not passed through each other, it
does not lie in the other body. Nor does it lie in a rigid tool, or the tool's point in the body.
"""

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.elements import LINE2, TRI3
from dolfinx_mortar.geometry.facets import Facets, facet_normals, facet_sizes
from dolfinx_mortar.geometry.sweep import find_passing, flat_parts
from dolfinx_mortar.geometry.turning import best_motion, path, rigid_sums, times_of
from dolfinx_mortar.mortar.pairing import THROUGH
from dolfinx_mortar.mortar.surface import Surface, coordinates, facets_at, thickness_behind


@dataclass(frozen=True)
class Middles:
    """The middle of the bodies behind the facets of a surface."""

    surface: Surface
    depth: Floats  # (m,) its distance from each facet at X

    def at(self, u: fem.Function) -> tuple[Floats, Floats]:
        """Return facets' centres (k, d) and the middles (k, d), of those with a finite depth."""
        finite, own = np.isfinite(self.depth), self.surface
        facets = facets_at(own, coordinates(own, u))[np.flatnonzero(finite)]
        faces = facets.x[:, np.array(own.element.vertices)].mean(axis=1)
        return faces, faces - self.depth[finite, None] * facet_normals(facets)


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
class SeenByTool:
    """Where a rigid tool sees points, in coordinates that move with it."""

    began: Callable[[Floats], Floats]  # points (n, d) at the start of a step
    now: Callable[[Floats], Floats]  # points at its end
    distance: Callable[[Floats], Floats]  # of such points (n,) from the tool, negative inside
    point: Floats  # (d,) of the tool


@dataclass(frozen=True)
class Passing:
    """What has passed through a surface, over all ranks."""

    surface: Surface | None  # through which, None for a tool
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
    facets = [facets_at(own, coordinates(own, u)) for u in (before, now)]
    (faces, start_at), (_, end_at) = side.at(before), side.at(now)
    parts = [flat_parts(facets_at(other, coordinates(other, u))) for u in (before, now)]
    start, end = (np.concatenate(comm.allgather(part)) for part in parts)
    d, origin = start.shape[2], start.mean(axis=(0, 1))  # the sums are made near it
    frame = best_motion(rigid_sums(*((x - origin).reshape(-1, d) for x in (start, end))))
    sums = rigid_sums(*((f.x - origin).reshape(-1, d) for f in facets))
    motion = best_motion(comm.allreduce(sums, op=MPI.SUM)).seen_from(frame)
    times = times_of([motion])
    ways = path(motion, times, start_at - origin, frame.back(end_at - origin))
    back = frame.back(end - origin)
    others = [(1.0 - t) * (start - origin) + t * back for t in times]
    found = [
        find_passing((ways[k], ways[k + 1]), (others[k], others[k + 1]))
        for k in range(len(times) - 1)
    ]
    return _first(side, other, faces, np.unique(np.concatenate(found)))


def _first(side: Middles, through: Surface | None, faces: Floats, passed: Longs) -> Passing | None:
    """Return what has passed, by the numbers of facets of this rank; collective."""
    comm, depth = side.surface.V.mesh.comm, side.depth[np.isfinite(side.depth)]
    count = comm.allreduce(len(passed), op=MPI.SUM)
    if not count:
        return None
    places = comm.allgather([(*faces[k].tolist(), float(depth[k])) for k in passed[:1]])
    *place, deep = min(found[0] for found in places if found)
    return Passing(through, count, tuple(place), deep)


def find_passed_tool(
    side: Middles, before: fem.Function, now: fem.Function, seen: SeenByTool
) -> Passing | None:
    """Return whether a body and a rigid tool have passed through each other; collective.

    Middles of the body that have been in the tool, or a point in the tool that has passed a facet,
    where it is deeper in the tool than the facet is long or the middle deep. If less deep, it has
    to go as much farther: a tip to which facets are chords lies a bit behind them. Paths are those
    that the tool sees, along arcs where body and tool turn against each other. Those of middles are
    followed by steps of the distance from the tool, which it cannot be nearer, and at least of half
    of the middle's depth.

    Args:
        side: of the body.
        before: displacement at the start of the step.
        now: that at its end.
        seen: how the tool sees points.
    """
    comm, own = side.surface.V.mesh.comm, side.surface
    x = [to(coordinates(own, u)) for to, u in ((seen.began, before), (seen.now, now))]
    depth = side.depth[np.isfinite(side.depth)]
    way = np.linalg.norm(x[1] - x[0], axis=1).max(initial=0.0)
    inner = depth_of_point(seen)
    most, least = maximum(comm, way, -depth.min(initial=np.inf))
    within = inner >= HALF_OF_DIGITS * least  # tips are on the surface, up to round-off
    if not most >= min(-least, inner if within else np.inf):
        return None
    (faces, start), (_, end) = side.at(before), side.at(now)
    start, end = seen.began(start), seen.now(end)
    motion = best_motion(comm.allreduce(rigid_sums(*(y[: own.owned] for y in x)), op=MPI.SUM))
    times = times_of([motion])
    ways = path(motion, times, start, end)
    inside = np.zeros(len(start), dtype=bool)
    with raised_together(comm):  # what a user's function raises
        outside = seen.distance(start) > 0.0
        for k in range(len(times) - 1):
            inside |= _enters(ways[k], ways[k + 1], THROUGH * depth, seen.distance)
    found = _first(side, None, faces, np.flatnonzero(inside & outside).astype(np.int64))
    if found is not None or not within:
        return found
    parts = path(motion, times, *(_behind(flat_parts(facets_at(own, y)), -least, inner) for y in x))
    point = seen.point[None]
    passes = [
        len(find_passing((point, point), (parts[k], parts[k + 1]))) for k in range(len(times) - 1)
    ]
    if not maximum(comm, float(sum(passes)))[0]:
        return None
    return Passing(None, 0, tuple(map(float, seen.point)), inner)


def depth_of_point(seen: SeenByTool) -> float:
    """Return how deep the tool's point is in it, -inf where it has no distance, as in an oval."""
    try:
        return -float(seen.distance(seen.point[None])[0])
    except ValueError:  # NaN or infinity, on all ranks
        return -np.inf


def _behind(parts: Floats, most: float, less: float) -> Floats:
    """Return lines or triangles (m, d, d) moved into their body by their size or `most`, - less."""
    facets = Facets(LINE2 if parts.shape[2] == 2 else TRI3, parts)
    shift = np.maximum(np.minimum(facet_sizes(parts), most) - less, 0.0)
    return np.asarray(parts - (shift[:, None] * facet_normals(facets))[:, None])


def _enters(a: Floats, b: Floats, step: Floats, distance: Callable[[Floats], Floats]) -> Bools:
    """Return which straight ways (n, d) from a to b lead to where a distance is negative.

    Args:
        a: starts.
        b: ends.
        step: (n,) how far points go on at least.
        distance: of points.

    Example:
        >>> a, b = np.array([[-3.0, 0.0], [-3.0, 2.0]]), np.array([[3.0, 0.0], [3.0, 2.0]])
        >>> _enters(a, b, np.full(2, 0.5), lambda x: np.hypot(*x.T) - 1.0).tolist()
        [True, False]
    """
    length, inside = np.linalg.norm(b - a, axis=1), np.zeros(len(a), dtype=bool)
    gone, on = np.zeros(len(a)), np.arange(len(a))
    while on.size:
        t = np.divide(gone[on], length[on], out=np.ones(len(on)), where=length[on] > 0.0)
        phi = distance((1.0 - t[:, None]) * a[on] + t[:, None] * b[on])
        inside[on] = phi < 0.0
        on, phi = on[(phi >= 0.0) & (t < 1.0)], phi[(phi >= 0.0) & (t < 1.0)]
        gone[on] = np.minimum(gone[on] + np.maximum(phi, step[on]), length[on])
    return inside
