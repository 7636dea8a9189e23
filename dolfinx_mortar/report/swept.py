# SPDX-License-Identifier: MIT
"""Bodies that nothing couples and that have moved into or through each other within a step."""

from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.audit.neighbours import boxes_of
from dolfinx_mortar.geometry.crossings import bounds, near_others, near_pairs
from dolfinx_mortar.geometry.sweep import find_entering, find_passing_edges, flat_parts
from dolfinx_mortar.geometry.turning import best_motion, path, rigid_sums, times_of
from dolfinx_mortar.mortar.surface import mean_facet_length
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.overlaps import SUNK
from dolfinx_mortar.report.uncoupled import Crossing, FacetParts, coupled_bodies, point


@dataclass(frozen=True)
class _Swept(FacetParts):
    """Those on their paths through a step; a side has all facets with a node on it."""

    path: Floats  # (m, t, k, d) vertices of facets or edges at t times

    def vertices(self) -> Floats:
        """Return the vertices at all times (m, t k, d)."""
        m, t, k, d = self.path.shape
        return self.path.reshape(m, t * k, d)

    def edges(self) -> "_Swept":
        """Return the edges of triangles, three to each."""
        ends = np.array([[0, 1], [1, 2], [2, 0]])
        m, t, _, d = self.path.shape
        path = self.path[:, :, ends].swapaxes(1, 2).reshape(3 * m, t, 2, d)
        return replace(self.part(np.repeat(np.arange(m), 3)), path=path)

    def between(self, first: int, last: int) -> "_Swept":
        """Return the straight paths between two of the times."""
        return replace(self, path=self.path[:, [first, last]])

    def groups(self) -> tuple[Longs, Bools]:
        """Return the group (m,) of each, and which groups (g, g) no interface couples.

        A group has one body, and the same sides of interfaces.
        """
        kinds = np.column_stack(
            [self.body, self.sides.reshape(len(self.body), 2 * self.sides.shape[2])]
        )
        _, first, group = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        body, sides = self.body[first], self.sides[first]
        coupled = (sides[:, None] & sides[None, :, ::-1]).any(axis=(2, 3))
        return group.ravel(), (body[:, None] != body) & ~coupled


def notes_on_swept(problem: ContactProblem, crossing: Crossing) -> list[str]:
    """Return a note if bodies have moved into or through each other unseen; collective.

    Since the last commit, on the paths of `dolfinx_mortar.geometry.turning`, as seen from the body
    with most facets. Measured, two elastic boxes of 45 thousand unknowns that touch, of the
    processor time of a step of one iteration that needs no set-up: 6 % at rest and where one
    slides by a third of its length or by all of it, 12 % where it turns by 30 degrees; in the
    plane with 47 thousand 2 and 7 %. Facets with a node on one side of an interface are left out
    with those of its other side: contacts see to those themselves, see `mortar.passing`. So are
    bodies whose sides overlapped before the step, whose contact has moved them out of each other.

    Args:
        problem: at the end of a step.
        crossing: what crosses there; a pair of bodies that the note on it names has none here.
    """
    if problem.bodies.count < 2:
        return []
    swept = _create(problem).received(problem.comm)
    bodies, places = _meetings(swept)
    if crossing.share > SUNK:
        other = (bodies != np.sort(np.array(crossing.bodies))).any(axis=1)
        bodies, places = bodies[other], places[other]
    found = _first(problem.comm, bodies, places)
    if found:
        overlapped = _overlapped(problem)
        found = {pair: place for pair, place in found.items() if pair not in overlapped}
    if not found:
        return []
    pair, place = min(found.items())
    x, y = (point(problem.bodies.centre[k]) for k in pair)
    more = f" (the first of {len(found)} pairs of bodies)" if len(found) > 1 else ""
    return [
        f"the bodies around {x} and {y} have moved into or through each other in this step, at "
        f"the material point that was at {point(np.array(place))} before it{more}: no interface "
        "couples them there; give them a Contact, or take smaller steps to see where they meet"
    ]


def _overlapped(problem: ContactProblem) -> set[tuple[int, int]]:
    """Return the pairs of bodies whose contacts overlapped at the last commit; collective."""
    x, n = problem.vector(problem.X), problem.d * problem.n
    x.array[:] += problem.committed.displacement[:n]
    found: set[tuple[int, int]] = set()
    for link in problem.system.unilateral:
        limit = -SUNK * mean_facet_length(link.sides.slave)
        deep = link.coupling.kept[:, 0] & (link.gaps(x) < limit)
        if any_rank(problem.comm, deep.any())[0]:
            found |= coupled_bodies(problem, link)
    return found


def _meetings(swept: _Swept) -> tuple[Longs, Floats]:
    """Return the pairs of bodies (q, 2) that meet, and the middles (q, d) of facets at the start.

    Between all times but one: who enters slowly is not deep enough at the next one.
    """
    groups = swept.groups()
    edges = swept.edges() if swept.path.shape[3] > 2 else None
    found = []
    for last in range(1, swept.path.shape[1]):
        step = swept.between(max(last - 2, 0), last)
        once = near_pairs(step.vertices(), *groups)
        pairs = np.concatenate([once, once[:, ::-1]])
        which = find_entering(step.path[:, 0], step.path[:, 1], pairs, SUNK)
        found.append((swept, pairs[which]))
        if edges is not None:
            step = edges.between(max(last - 2, 0), last)
            pairs = _near_edges(step, once)
            which = find_passing_edges(step.path[:, 0], step.path[:, 1], pairs, SUNK)
            found.append((edges, pairs[which]))
    bodies = [np.sort(parts.body[pairs], axis=1) for parts, pairs in found]
    places = [parts.path[pairs[:, 0], 0].mean(axis=1) for parts, pairs in found]
    return np.concatenate(bodies), np.concatenate(places)


def _near_edges(edges: _Swept, pairs: Longs) -> Longs:
    """Return the pairs (q, 2) of edges of pairs (p, 2) of triangles whose boxes meet.

    Of two opposite edges of neighbours, only that with the later end is looked at.
    """
    start = edges.path[:, 0]
    later = np.sign(start[:, 1] - start[:, 0]) @ [9, 3, 1] > 0  # the first that differs
    a, b = (3 * pairs[:, :, None, None] + np.mgrid[:3, :3]).swapaxes(0, 1).reshape(2, -1)
    some = later[a] & later[b]
    a, b = a[some], b[some]
    (low, high), (least, most) = (bounds(edges.vertices()[k]) for k in (a, b))
    meet = ((low <= most) & (high >= least)).all(axis=1)
    return np.stack([a[meet], b[meet]], axis=1)


def _first(comm: MPI.Comm, bodies: Longs, places: Floats) -> dict[tuple[int, int], list[float]]:
    """Return the least place (q, d) of every pair of bodies (q, 2) of all ranks; collective."""
    rows = np.column_stack([bodies, places])
    rows = rows[np.lexsort(rows.T[::-1])][::-1]  # the least of each pair is the last one
    mine: dict[tuple[int, int], list[float]] = {
        (int(row[0]), int(row[1])): [*map(float, row[2:])] for row in rows
    }
    found: dict[tuple[int, int], list[float]] = {}
    for rank in comm.allgather(mine):
        for pair, place in rank.items():
            found[pair] = min(place, found.get(pair, place))
    return found


def _create(problem: ContactProblem) -> _Swept:
    """Return the own exterior facets whose paths meet the box of the path of another body."""
    comm, boundary, d = problem.comm, problem.system.boundary, problem.d
    began = fem.Function(problem.V)
    began.x.array[: d * problem.n] = problem.committed.displacement
    began.x.scatter_forward()
    start, end = (boundary.at(u) for u in (began, problem.u))
    again = np.arange(len(flat_parts(start))) % max(len(start.x), 1)  # see `uncoupled._create_skin`
    body = problem.bodies.of_cells[boundary.cells].astype(np.int64)[again]
    path = _paths(comm, body, problem.bodies.centre, (flat_parts(start), flat_parts(end)))
    swept = _Swept(body, _touched(problem)[again], path)
    boxes = boxes_of(comm, swept.vertices(), body, problem.bodies.count)
    return swept.part(near_others(swept.vertices(), body, boxes))


def _paths(comm: MPI.Comm, body: Longs, centre: Floats, x: tuple[Floats, Floats]) -> Floats:
    """Return the paths (m, t, k, d) of facets from start to end x (m, k, d); collective.

    Args:
        comm: the ranks.
        body: number (m,) of the body of each facet.
        centre: of each body, near which its sums are made.
        x: vertices at both times.
    """
    count, d = centre.shape
    sums = np.zeros((count, d + 1, 2 * d + 1))
    for k in np.unique(body):
        sums[k] = rigid_sums(*((y[body == k] - centre[k]).reshape(-1, d) for y in x))
    comm.Allreduce(MPI.IN_PLACE, sums)
    motions = [best_motion(sums[k]).about(centre[k]) for k in range(count)]
    frame = motions[int(sums[:, 0, 0].argmax())]
    seen = [motion.seen_from(frame) for motion in motions]
    times = times_of(seen)
    result = np.zeros((len(body), len(times), *x[0].shape[1:]))
    for k in np.unique(body):
        start, end = (y[body == k] for y in x)
        result[body == k] = path(seen[k], times, start, frame.back(end)).swapaxes(0, 1)
    return result


def _touched(problem: ContactProblem) -> Bools:
    """Return whether facets (m, 2, interfaces) have a node on a side of each interface."""
    boundary, sides = problem.system.boundary, problem.system.sides
    result = np.zeros((len(boundary.nodes), 2, len(sides)), dtype=bool)
    marks = la.vector(problem.V.dofmap.index_map)
    for k, interface in enumerate(sides):
        for j, surface in enumerate(interface.surfaces):
            marks.array[:] = 0.0
            marks.array[surface.nodes[: surface.owned]] = 1.0
            marks.scatter_forward()
            result[:, j, k] = (marks.array[boundary.nodes] > 0.0).any(axis=1)
    return result
