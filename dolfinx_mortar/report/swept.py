# SPDX-License-Identifier: MIT
"""Bodies that nothing couples and that have moved into or through each other within a step."""

from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.audit.neighbours import boxes_of
from dolfinx_mortar.geometry.crossings import near_others, near_pairs
from dolfinx_mortar.geometry.sweep import find_entering, find_passing_edges, flat_parts
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.overlaps import SUNK
from dolfinx_mortar.report.uncoupled import Crossing, FacetParts, point


@dataclass(frozen=True)
class _Swept(FacetParts):
    """Those at the start and the end of a step; a side has all facets with a node on it."""

    start: Floats  # (m, k, d) vertices of facets or edges
    end: Floats  # (m, k, d), less the mean motion of all

    def vertices(self) -> Floats:
        """Return the vertices at both times (m, 2 k, d)."""
        return np.concatenate([self.start, self.end], axis=1)

    def edges(self) -> "_Swept":
        """Return the edges of triangles: of two of opposite facets, that with the later end."""
        ends = np.array([[0, 1], [1, 2], [2, 0]])
        start, end = (x[:, ends].reshape(-1, 2, 3) for x in (self.start, self.end))
        which = np.repeat(np.arange(len(self.body)), len(ends))
        later = np.sign(start[:, 1] - start[:, 0]) @ [9, 3, 1] > 0  # the first that differs counts
        return replace(self.part(which), start=start, end=end).part(later)

    def pairs(self) -> Longs:
        """Return pairs (p, 2), each once, whose paths meet and which no interface couples."""
        found = near_pairs(self.vertices(), self.body)
        one, other = self.sides[found.T]
        return found[~(one & other[:, ::-1]).any(axis=(1, 2))]


def notes_on_swept(problem: ContactProblem, crossing: Crossing) -> list[str]:
    """Return a note if bodies have moved into or through each other unseen; collective.

    Since the last commit, on straight paths: a corner that turns by a large angle moves along an
    arc, beyond its path here. Measured, two elastic boxes of 30 thousand unknowns, of a step's
    processor time: 1.8 % at rest, 2.4 % where one slides by a third of its length, 5.5 % by all of
    it. Facets with a node on one side of an interface are left out with those of its other side:
    contacts see to those themselves, see `mortar.passing`.

    Args:
        problem: at the end of a step.
        crossing: what crosses there; a pair of bodies that the note on it names has none here.
    """
    if problem.bodies.count < 2:
        return []
    swept = _create(problem).received(problem.comm)
    pairs = swept.pairs()
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    which, places = find_entering(swept.start, swept.end, pairs, SUNK)
    bodies = np.sort(swept.body[pairs[which]], axis=1)
    if problem.d > 2:
        edges = swept.edges()
        pairs = edges.pairs()
        pairs = pairs[find_passing_edges(edges.start, edges.end, pairs, SUNK)]
        bodies = np.concatenate([bodies, np.sort(edges.body[pairs], axis=1)])
        places = np.concatenate([places, edges.start[pairs[:, 0]].mean(axis=1)])
    if crossing.share > SUNK:
        other = (bodies != np.sort(np.array(crossing.bodies))).any(axis=1)
        bodies, places = bodies[other], places[other]
    found = _first(problem.comm, bodies, places)
    if not found:
        return []
    pair, place = min(found.items())
    x, y = (point(problem.bodies.centre[k]) for k in pair)
    more = f" (the first of {len(found)} pairs of bodies)" if len(found) > 1 else ""
    return [
        f"the bodies around {x} and {y} have moved into or through each other in this step, as "
        f"what was at {point(np.array(place))} at its start{more}: no interface couples them "
        "there; give them a Contact, or take smaller steps to see where they meet"
    ]


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
    x = [flat_parts(facets) for facets in (start, end)]
    again = np.arange(len(x[0])) % max(len(start.x), 1)  # see `uncoupled._create_skin`
    moved = np.array([*(x[1] - x[0]).sum(axis=(0, 1)), len(x[0]) * d], dtype=float)
    comm.Allreduce(MPI.IN_PLACE, moved)
    x[1] = x[1] - moved[:d] / moved[d]  # a common translation does not count
    body = problem.bodies.of_cells[boundary.cells].astype(np.int64)[again]
    swept = _Swept(body, _touched(problem)[again], *x)
    boxes = boxes_of(comm, swept.vertices(), body, problem.bodies.count)
    return swept.part(near_others(swept.vertices(), body, boxes))


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
