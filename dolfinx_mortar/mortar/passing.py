# SPDX-License-Identifier: MIT
"""Whether one side has passed through the other in a step, undetected by contact.

Facets deeper than a part of the thinner body are not paired (`THROUGH`). So the middle of the body
behind each facet must not enter the other body or a rigid tool; nor the tool's point the body.

The best-fitting rigid motion x -> R x + c of a step is taken as steady, about a fixed line (in 2D,
a point) with a shift along it:

    x(t) = R^t ((1 - t) x_0 + t R^-1 x_1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx.fem import Function
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arrays import (
    HALF_OF_DIGITS,
    QUARTER_OF_DIGITS,
    Bools,
    Floats,
    Ints,
    Longs,
)
from dolfinx_mortar.geometry.facets import LINE2, TRI3, Facets, facet_normals, facet_sizes
from dolfinx_mortar.geometry.flat import find_passing, flat_parts
from dolfinx_mortar.mortar.pairing import THROUGH
from dolfinx_mortar.mortar.surface import Surface, coordinates, facets_at, thickness_of_bodies


class Middles(NamedTuple):
    """Middles of the bodies behind facets."""

    surface: Surface
    depth: Floats  # (m,) distance from the facet at X

    def at(self, u: Function) -> tuple[Floats, Floats]:
        """Centres and middles (k, d) of facets of finite depth."""
        finite, own = np.isfinite(self.depth), self.surface
        facets = facets_at(own, coordinates(own, u))[np.flatnonzero(finite)]
        faces = facets.x[:, own.element.vertices].mean(axis=1)
        return faces, faces - self.depth[finite, None] * facet_normals(facets)


def find_middles(surface: Surface, body_of: Ints, skin: Facets, bodies: Ints) -> Middles:
    """The middles of the bodies behind a surface; collective.

    `body_of` (m,) and `bodies` are the bodies of its facets and of this rank's exterior facets.
    """
    facets = facets_at(surface, surface.X)
    depth = thickness_of_bodies(surface.V.mesh.comm, facets, body_of, skin, bodies)
    return Middles(surface, THROUGH * depth)


class SeenByTool(NamedTuple):
    """Motion of points relative to a rigid tool."""

    at: Callable[[float, Floats], Floats]  # time in (0, 1), points (.., d) -> tool's frame
    turn: Floats  # (1,) or (3,) rotation in the step, radians
    distance: Callable[[Floats], Floats]  # (n,) of such points, negative inside
    point: Floats  # (d,) of the tool

    def turns_round(self, body: RigidMotion) -> bool:
        """Whether the relative rotation is half a turn or more."""
        against = body.rotation()
        against[-len(self.turn) :] -= self.turn
        return bool(np.linalg.norm(against) >= np.pi - HALF_OF_DIGITS)

    def ways(self, body: RigidMotion, start: Floats, end: Floats) -> list[Floats]:
        """Paths (t, .., d) in the tool's frame, of points in space at start and end.

        The body turns steadily in space, and the tool about its point, which moves straight.
        """
        times = times_of(body.angle() + float(np.degrees(np.linalg.norm(self.turn))))
        ways = zip(times, path(body, times, start, end), strict=True)
        return [self.at(t, np.asarray(x)) for t, x in ways]


@dataclass(frozen=True)
class Passing:
    """Bodies that have passed through a surface, on all ranks."""

    surface: Surface | None  # None for a tool
    count: int  # whose middle has passed
    place: tuple[float, ...]  # of one of these, at the start
    depth: float  # distance to its middle


def is_far(slave: Middles, master: Middles, before: Floats, now: Floats) -> bool:
    """Whether relative displacements (owned nodes, d) reach the least depth; collective."""
    sides = slave.surface, master.surface
    nodes = np.concatenate([side.nodes[: side.owned] for side in sides])
    least_depth = min(side.depth.min(initial=np.inf) for side in (slave, master))
    moved = now[nodes] - before[nodes]
    most, least = moved.max(axis=0, initial=-np.inf), moved.min(axis=0, initial=np.inf)
    found = maximum(sides[0].V.mesh.comm, -least_depth, *most, *-least)
    extent = found[1:].reshape(2, -1).sum(axis=0)
    return bool(np.linalg.norm(extent) >= -found[0])


def find_passed(slave: Middles, master: Middles, before: Function, now: Function) -> Passing | None:
    """The side through which the other one has passed, or None; collective.

    All ranks get all facets of a side: call `is_far` first.
    """
    found = _passed(slave, master.surface, before, now)
    return _passed(master, slave.surface, before, now) if found is None else found


def _passed(side: Middles, other: Surface, before: Function, now: Function) -> Passing | None:
    own, comm = side.surface, other.V.mesh.comm
    facets = [facets_at(own, coordinates(own, u)) for u in (before, now)]
    (faces, start_at), (_, end_at) = side.at(before), side.at(now)
    parts = [flat_parts(facets_at(other, coordinates(other, u))) for u in (before, now)]
    start, end = (np.concatenate(comm.allgather(part)) for part in parts)
    d, origin = start.shape[2], start.mean(axis=(0, 1))  # for the accuracy of the sums
    frame = best_motion(rigid_sums(*((x - origin).reshape(-1, d) for x in (start, end))))
    sums = rigid_sums(*((f.x - origin).reshape(-1, d) for f in facets))
    motion = best_motion(comm.allreduce(sums, op=MPI.SUM)).seen_from(frame)
    times = times_of(motion.angle())
    ways = path(motion, times, start_at - origin, frame.back(end_at - origin))
    back = frame.back(end - origin)
    others = [(1.0 - t) * (start - origin) + t * back for t in times]
    found = [
        find_passing((ways[k], ways[k + 1]), (others[k], others[k + 1]))
        for k in range(len(times) - 1)
    ]
    passed = np.unique(np.concatenate(found))
    if comm.allreduce(len(passed), op=MPI.SUM):
        # not those that have left their own body as it bends
        inward = np.concatenate(comm.allgather(flat_parts(facets[0])))[:, ::-1]
        passed = np.setdiff1d(passed, find_passing((faces, start_at), (inward, inward)))
    return _first(side, other, faces, passed)


def _first(side: Middles, through: Surface | None, faces: Floats, passed: Longs) -> Passing | None:
    comm, depth = side.surface.V.mesh.comm, side.depth[np.isfinite(side.depth)]
    count = comm.allreduce(len(passed), op=MPI.SUM)
    if not count:
        return None
    places = comm.allgather([(*faces[k].tolist(), float(depth[k])) for k in passed[:1]])
    *place, deep = min(found[0] for found in places if found)
    return Passing(through, count, tuple(place), deep)


def find_passed_tool(
    side: Middles, before: Function, now: Function, seen: SeenByTool, removed: float = 0.0
) -> Passing | None:
    """Whether a body and a rigid tool have passed through each other; collective.

    Either middles of the body have entered the tool, or the tool's point has passed a facet moved
    inward to the depth of its middle (at most its size) less the point's depth in the tool, as
    chords lie behind a tip, and by the depth of `removed` material. Parts of paths shorter than
    `QUARTER_OF_DIGITS` of the depth are missed.
    """
    comm, own = side.surface.V.mesh.comm, side.surface
    x = [coordinates(own, u) for u in (before, now)]
    y = [seen.at(t, at) for t, at in zip((0.0, 1.0), x, strict=True)]
    depth = side.depth[np.isfinite(side.depth)]
    way = np.linalg.norm(y[1] - y[0], axis=1).max(initial=0.0)
    inner = depth_of_point(comm, seen)
    most, least = maximum(comm, way, -depth.min(initial=np.inf))
    within = inner >= HALF_OF_DIGITS * least  # tips are on the surface
    body = best_motion(comm.allreduce(rigid_sums(*(at[: own.owned] for at in x)), op=MPI.SUM))
    near = not most >= min(-least, inner if within else np.inf)
    if near and not seen.turns_round(body):
        return None
    (faces, start), (_, end) = side.at(before), side.at(now)
    with raised_together(comm):  # errors of a user's function
        ways = seen.ways(body, start, end)
        entered = np.flatnonzero(_enter(ways, QUARTER_OF_DIGITS * depth, seen.distance))
    found = _first(side, None, faces, entered.astype(np.int64))
    if found is not None or not within:
        return found
    inward = (_behind(flat_parts(facets_at(own, at)), -least, inner - removed) for at in x)
    parts = seen.ways(body, *inward)
    point = seen.point[None]
    passes = sum(len(find_passing((point, point), (a, b))) for a, b in pairwise(parts))
    if not maximum(comm, float(passes))[0]:
        return None
    return Passing(None, 0, tuple(map(float, seen.point)), inner)


def depth_of_point(comm: MPI.Comm, seen: SeenByTool) -> float:
    """Depth of the tool's point in it, -inf if it has no distance; collective."""
    try:
        apart = float(seen.distance(seen.point[None])[0])
    except Exception:  # of a user's function
        apart = np.inf
    return -float(maximum(comm, np.inf if np.isnan(apart) else apart)[0])


def _behind(parts: Floats, most: float, less: float) -> Floats:
    """Lines or triangles moved inward by min(size, `most`) - less."""
    facets = Facets(LINE2 if parts.shape[2] == 2 else TRI3, parts)
    shift = np.maximum(np.minimum(facet_sizes(parts), most) - less, 0.0)
    return parts - (shift[:, None] * facet_normals(facets))[:, None]


def _enter(ways: list[Floats], least: Floats, distance: Callable[[Floats], Floats]) -> Bools:
    """Which paths, (n, d) at each time, enter negative distances by at least `least` (n,).

    Example:
        >>> ways = [np.array([[-3.0, 0.0], [-3.0, 2.0]]), np.array([[9.0, 0.0], [9.0, 2.0]])]
        >>> _enter(ways, np.full(2, 0.02), lambda x: np.hypot(*x.T) - 0.01).tolist()
        [True, False]
    """
    phi = [distance(x) for x in ways]
    inside, outside = phi[0] < 0.0, phi[0] > 0.0
    for ends, distances in zip(pairwise(ways), pairwise(phi), strict=True):
        inside |= _cross(ends, distances, least, distance)
    return inside & outside


def _cross(
    ends: tuple[Floats, Floats],
    phi: tuple[Floats, Floats],
    least: Floats,
    distance: Callable[[Floats], Floats],
) -> Bools:
    """As `_enter`, for straight paths, by bisection."""
    (a, b), (near, far) = ends, phi
    inside, left = far < 0.0, np.arange(len(a))
    while left.size:
        length = np.linalg.norm(b - a, axis=1)
        some = (length > near + far) & (length > least[left]) & ~inside[left]
        left, a, b, near, far = left[some], a[some], b[some], near[some], far[some]
        if not left.size:
            break
        half = (a + b) / 2
        between = distance(half)
        inside[left[between < 0.0]] = True
        left = np.concatenate([left, left])
        a, b = np.concatenate([a, half]), np.concatenate([half, b])
        near, far = np.concatenate([near, between]), np.concatenate([between, far])
    return inside


TURN = 10.0
"""Largest rotation in degrees between two times of a path: the chord of an arc deviates by 1 -
cos(5 degrees) = 0.4 % of the radius, that of two such parts by 1.5 %."""


class RigidMotion(NamedTuple):
    """The motion x -> R x + c."""

    R: Floats  # (d, d)
    c: Floats  # (d,)

    def at(self, x: Floats) -> Floats:
        """Images of points (.., d)."""
        return x @ self.R.T + self.c

    def back(self, x: Floats) -> Floats:
        """Preimages of points (.., d)."""
        return (x - self.c) @ self.R

    def seen_from(self, other: RigidMotion) -> RigidMotion:
        """The motion relative to another one."""
        return RigidMotion(other.R.T @ self.R, other.back(self.c))

    def rotation(self) -> Floats:
        """Rotation vector (3,) in radians; in 2D along the third axis."""
        R, d = np.eye(3), len(self.c)
        R[:d, :d] = self.R
        return scipy.spatial.transform.Rotation.from_matrix(R).as_rotvec()

    def angle(self) -> float:
        """Angle of the rotation in degrees."""
        return float(np.degrees(np.linalg.norm(self.rotation())))

    def part(self, t: float) -> RigidMotion:
        """The share t of a steady motion with a rotation.

        Example:
            >>> quarter = RigidMotion(np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([2.0, 0.0]))
            >>> quarter.part(0.5).at(np.array([[1.0, 1.0], [0.0, 0.0]])).round(3).tolist()
            [[1.0, 1.0], [1.0, -0.414]]
        """
        d = len(self.c)
        R = scipy.spatial.transform.Rotation.from_rotvec(t * self.rotation()).as_matrix()[:d, :d]
        turns = np.eye(d) - self.R
        fixed = np.linalg.pinv(turns) @ self.c  # on the axis
        along = self.c - turns @ fixed
        return RigidMotion(R, fixed - R @ fixed + t * along)


def rigid_sums(start: Floats, end: Floats) -> Floats:
    """Sums for `best_motion`; they add up over ranks."""
    one = np.ones((len(start), 1))
    return np.concatenate([one, start], axis=1).T @ np.concatenate([one, start, end], axis=1)


def best_motion(sums: Floats) -> RigidMotion:
    """The rigid motion that fits best (Kabsch 1976), from the sums of `rigid_sums`.

    Example:
        >>> x = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        >>> found = best_motion(rigid_sums(x, x @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + [2.0, 0.0]))
        >>> bool(np.abs(found.at(x) - [[2, 0], [2, 1], [1, 0]]).max() < 1e-12)
        True
    """
    d = len(sums) - 1
    start, end = sums[0, 1 : d + 1] / sums[0, 0], sums[0, d + 1 :] / sums[0, 0]
    products = sums[1:, d + 1 :] - sums[0, 0] * np.outer(start, end)
    U, _, Vt = np.linalg.svd(products.T)
    signs = np.ones(d)
    signs[-1] = np.linalg.det(U @ Vt)
    R = (U * signs) @ Vt
    return RigidMotion(R, end - R @ start)


def times_of(angle: float) -> Floats:
    """Times between which a rotation by an angle in degrees is less than `TURN`."""
    return np.asarray(np.linspace(0.0, 1.0, max(int(np.ceil(angle / TURN)), 1) + 1), dtype=float)


def path(motion: RigidMotion, times: Floats, start: Floats, end: Floats) -> Floats:
    """Points (t, .., d) of a path between its start and end."""
    if motion.angle() <= TURN:
        return np.stack([(1.0 - t) * start + t * end for t in times])
    held = motion.back(end)
    return np.stack([motion.part(t).at((1.0 - t) * start + t * held) for t in times])
