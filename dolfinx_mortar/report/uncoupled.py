# SPDX-License-Identifier: MIT
"""Bodies whose boundaries cross where no contact and no tie couples them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

from mpi4py import MPI

import numpy as np

from dolfinx import la
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.audit.neighbours import boxes_of
from dolfinx_mortar.geometry.crossings import (
    Crossings,
    bounds,
    find_crossings,
    near_others,
    near_pairs,
)
from dolfinx_mortar.geometry.elements import LINE2, TRI3
from dolfinx_mortar.geometry.facets import Facets, facet_normals, facet_sizes
from dolfinx_mortar.geometry.sweep import flat_parts
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.edges import SUNK
from dolfinx_mortar.mortar.surface import cells_of, coordinates, facets_at, nodal_sagittas
from dolfinx_mortar.problem.problem import ContactProblem


def _point(x: Floats) -> str:
    """Write a point for a note.

    >>> _point(np.array([0.5, -2.0]))
    '(0.5, -2)'
    """
    return f"({', '.join(f'{c:.4g}' for c in x)})"


@dataclass(frozen=True)
class Crossing:
    """The deepest crossing of boundaries that are not coupled."""

    share: float = 0.0  # depth over the length of the smaller facet
    depth: float = 0.0
    place: Sequence[float] = ()
    bodies: Sequence[int] = ()


@dataclass(frozen=True)
class _Skin:
    """Facets near other bodies."""

    body: Longs  # (m,)
    sides: Bools  # (m, 2, interfaces) whether they belong to its slave and its master side
    x: Floats  # (m, d, d)
    on: Bools  # (m, d, 2, interfaces) whether their vertices belong to its slave and master side
    sagitta: Floats  # (m,) of the sides of interfaces to which they belong, or which they touch

    def part(self, which: Bools | Longs) -> "_Skin":
        """Return some of the facets."""
        return _Skin(*(getattr(self, f.name)[which] for f in fields(self)))

    def received(self, comm: MPI.Comm) -> "_Skin":
        """Return the own facets, and those of other ranks that their box meets; collective."""
        if comm.size == 1:
            return self
        low, high = bounds(self.x)
        box = low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf)
        sent = [
            self.part(((low <= most) & (high >= least)).all(axis=1) & (rank != comm.rank))
            for rank, (least, most) in enumerate(comm.allgather(box))
        ]
        parts = [self, *comm.alltoall(sent)]
        return _Skin(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(self)))

    def apart(self, pairs: Longs) -> Longs:
        """Return those of pairs (p, 2) that are no two sides of one interface facing each other."""
        one, other = pairs.T
        coupled = (self.sides[one] & self.sides[other][:, ::-1]).any(axis=(1, 2))
        n = facet_normals(Facets(LINE2 if self.x.shape[2] == 2 else TRI3, self.x))
        return pairs[~(coupled & ((n[one] * n[other]).sum(axis=1) < -HALF_OF_DIGITS))]


def find_crossing(problem: ContactProblem) -> Crossing:
    """Return the deepest crossing of the boundaries of bodies at X + u; collective.

    Of two bodies, and of a surface that a contact of it with itself should keep from crossing. Of
    facets of two bodies that face each other and are the two sides of one interface there is none:
    where these overlap, the interface has seen it. Beside a tie bodies overlap by its jump, as
    where a bolt is cut, which is taken off. Facets are taken as flat between their vertices: at the
    rim of curved sides they reach into the faces beside them, by both sagittas at most, which are
    taken off.
    """
    every = [find_self_crossing(problem, link) for link in problem.system.unilateral]
    if problem.bodies.count > 1:
        every.append(_find_between(problem))
    return max(every, key=lambda found: found.share, default=Crossing())


def find_self_crossing(problem: ContactProblem, link: Link) -> Crossing:
    """Return the deepest crossing of a surface that meets itself; collective.

    But for a slave and a master that face each other: where these overlap, the interface has seen
    it. Two slaves or two masters are kept apart by nothing.
    """
    if not link.sides.meet_themselves or link.pairing is None or link.pairing.roles is None:
        return Crossing()
    comm, surface = problem.comm, link.sides.slave
    x = coordinates(surface, problem.u)
    facets, sagittas = facets_at(surface, x), nodal_sagittas(surface, x)[surface.facets]
    flat = flat_parts(facets)
    again = np.arange(len(flat)) % max(len(facets.x), 1)  # see `_create_skin`
    sagitta, slave = sagittas.max(axis=1, initial=0.0)[again], link.pairing.roles.slave[again]
    sides = np.stack([slave, ~slave], axis=1)[:, :, None]
    on = np.repeat(sides[:, None], flat.shape[1], axis=1)
    skin = _Skin(np.zeros_like(again), sides, flat, on, sagitta).received(comm)
    pairs = near_pairs(skin.x, skin.body, np.ones((1, 1), dtype=bool))
    found = find_crossings(skin.x, skin.apart(pairs))
    one, other = skin.part(found.pairs[:, 0]), skin.part(found.pairs[:, 1])
    depth = np.maximum(found.depth - one.sagitta - other.sagitta, 0.0)
    share = depth / np.minimum(facet_sizes(one.x), facet_sizes(other.x))
    body = int(maximum(comm, problem.bodies.of_cells[cells_of(surface)].max(initial=0))[0])
    return _deepest(comm, share, depth, found.place, np.full((len(share), 2), body))


def _deepest(
    comm: MPI.Comm, share: Floats, depth: Floats, place: Floats, bodies: Longs
) -> Crossing:
    """Return the crossing with the largest share of all ranks; collective."""
    columns = share, depth, place, bodies
    mine = [[column[i].tolist() for column in columns] for i in np.argsort(share)[-1:]]
    everywhere = [parts for rank in comm.allgather(mine) for parts in rank]
    return Crossing(*max(everywhere)) if everywhere else Crossing()


def _find_between(problem: ContactProblem) -> Crossing:
    """Return the deepest crossing of the boundaries of two bodies; collective."""
    comm, own = problem.comm, _create_skin(problem)
    skin, others = own.received(comm), ~np.eye(problem.bodies.count, dtype=bool)
    found = find_crossings(skin.x, skin.apart(near_pairs(skin.x, skin.body, others)))
    found = found.part(found.pairs[:, 1] < len(own.body))  # its rank has all facets at the edge
    one, other = skin.part(found.pairs[:, 0]), skin.part(found.pairs[:, 1])
    size = np.minimum(facet_sizes(one.x), facet_sizes(other.x))
    reach = np.minimum(_seen_reach(one, other), _seen_reach(other, one))
    tied = (_touched(one) & _touched(other)[:, ::-1]).any(axis=1)
    meant = (tied * _longest_jumps(problem)).max(axis=1, initial=0.0)
    deep = np.minimum(found.depth, _from_seen_edges(found.place, one, other))
    depth = np.minimum(deep - one.sagitta - other.sagitta, reach) - meant
    depth = _least_at_edges(found, depth.clip(min=0.0))
    bodies = np.stack([one.body, other.body], axis=1)
    return _deepest(comm, depth / size, depth, found.place, bodies)


def _touched(skin: _Skin) -> Bools:
    """Tell (m, 2, interfaces) which sides facets belong to or end in."""
    return np.asarray(skin.on.any(axis=1))


def _longest_jumps(problem: ContactProblem) -> Floats:
    """Return the length of the jump of each interface, by which its sides overlap; collective."""
    lengths = [
        np.linalg.norm(link.apart(), axis=1).max(initial=0.0) for link in problem.system.links
    ]
    return np.asarray(maximum(problem.comm, *lengths)) if lengths else np.zeros(0)


def _least_at_edges(found: Crossings, depth: Floats) -> Floats:
    """Return the least of the depths (p,) of all facets that share an edge and cross with it.

    The edge between the top of a block and its flank lies along a flank of another block that
    stands on it and ends there. By round-off it crosses that, far from both of its ends, where no
    contact has its own flank; but its top sees where the other block ends.
    """
    edges = np.column_stack([found.ends, found.pairs[:, 1]])
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    least = np.full(len(depth), np.inf)
    np.minimum.at(least, edge.ravel(), depth)
    return least[edge.ravel()]


def _seen_reach(one: _Skin, other: _Skin) -> Floats:
    """Return how far (m,) facets reach behind others, infinity where no interface sees all of that.

    The flank of a block that stands on a larger one ends in nodes of the contact. These say how
    deep it is: a facet below them, which rises beside the flank, reaches beyond it by half of it.
    """
    n = facet_normals(Facets(LINE2 if one.x.shape[2] == 2 else TRI3, one.x))
    behind = -np.einsum("mkd,md->mk", other.x - one.x[:, :1], n)
    seen = (one.sides[:, None] & other.on[:, :, ::-1]).any(axis=(2, 3))
    return np.where(seen | (behind <= 0.0), behind, np.inf).max(axis=1, initial=0.0)


def _from_seen_edges(place: Floats, one: _Skin, other: _Skin) -> Floats:
    """Return how far (m,) from an edge that an interface sees facets are crossed, or infinity.

    The end of a ring on a shaft is crossed by facets along the shaft, far from both of their ends,
    but beside the rim of the bore, by the sagittas of both.

    Args:
        place: (m, d) where edges of facets cross others.
        one: (m,) those with the edges.
        other: (m,) those which are crossed.
    """
    d, least = place.shape[1], np.full(len(place), np.inf)
    beside = ~(one.sides & other.sides[:, ::-1]).any(axis=(1, 2))
    on = one.sides[:, None] & other.on[:, :, ::-1]
    for k in range(d) if d == 3 else ():
        p, along = other.x[:, k], other.x[:, (k + 1) % d] - other.x[:, k]
        t = ((place - p) * along).sum(axis=1) / (along * along).sum(axis=1)
        away = np.linalg.norm(place - p - t.clip(0.0, 1.0)[:, None] * along, axis=1)
        seen = beside & (on[:, k] & on[:, (k + 1) % d]).any(axis=(1, 2))
        np.minimum(least, np.where(seen, away, np.inf), out=least)
    return least


def notes_on_crossings(problem: ContactProblem, found: Crossing) -> list[str]:
    """Return a note if boundaries cross by more than the discretisation explains."""
    if found.share <= SUNK:
        return []
    centres = problem.bodies.centre[list(found.bodies)]
    where, *around = (_point(x) for x in (np.array(found.place), *centres))
    if len(set(found.bodies)) == 1:
        return [
            f"the surface of the body around {around[0]} lies in itself around {where}, by "
            f"{found.depth:.3g}, {found.share:.0%} of a facet there, and its contact with itself "
            "has no pairs there; take smaller steps, finer facets, or a tag for each of the parts"
        ]
    remedy = "give them a Contact, or add these facets to the sides of one"
    pair = min(found.bodies), max(found.bodies)
    if any(pair in _coupled_bodies(problem, link) for link in problem.system.unilateral):
        remedy = (
            "their contact has no pairs there: add these facets to its sides, or where its sides "
            "run around a body that is thinner than twice the overlap, tag only faces that touch"
        )
    return [
        f"the bodies around {around[0]} and {around[1]} lie in each other around {where}, where no "
        f"interface couples them: by {found.depth:.3g}, {found.share:.0%} of a facet there; "
        f"{remedy}"
    ]


def _coupled_bodies(problem: ContactProblem, link: Link) -> set[tuple[int, int]]:
    """Return the pairs of bodies on the two sides of an interface; collective."""
    if link.sides.master is None:
        return set()
    own = [problem.bodies.of_cells[cells_of(side)] for side in link.sides.surfaces]
    on = [set(np.concatenate(problem.comm.allgather(bodies)).tolist()) for bodies in own]
    return {(min(a, b), max(a, b)) for a in on[0] for b in on[-1]}


def _create_skin(problem: ContactProblem) -> _Skin:
    """Return the exterior facets of this rank that the box of another body meets; collective."""
    boundary = problem.system.boundary
    facets, nodes = boundary.at(problem.u), boundary.nodes
    body = problem.bodies.of_cells[boundary.cells].astype(np.int64)
    sides = np.zeros((len(body), 2, len(problem.system.sides)), dtype=bool)
    index_map, count = problem.V.dofmap.index_map, sides.shape[2]
    sagittas, marks = la.vector(index_map), la.vector(index_map, 2 * count)
    sagittas.array[:] = marks.array[:] = 0.0
    marked = marks.array.reshape(len(sagittas.array), 2, count)
    for k, interface in enumerate(problem.system.sides):
        for j, surface in enumerate(interface.surfaces):
            sides[:, j, k] = np.isin(boundary.entities, surface.entities)
            own = surface.nodes[: surface.owned]
            found = nodal_sagittas(surface, coordinates(surface, problem.u))[: surface.owned]
            sagittas.array[own] = np.maximum(sagittas.array[own], found)
            marked[own, j, k] = 1.0
    sagittas.scatter_forward()
    marks.scatter_forward()
    sagitta = sagittas.array[nodes].max(axis=1, initial=0.0)
    boxes = boxes_of(problem.comm, facets.x, body, problem.bodies.count)
    near = near_others(facets.x, body, boxes)
    x, count = flat_parts(facets[near]), int(near.sum())
    again = np.arange(len(x)) % max(count, 1)  # the halves of quadrilaterals follow each other
    on = flat_parts(Facets(facets.element, marked[nodes[near]])) > 0.0
    body, sides, sagitta = (part[near][again] for part in (body, sides, sagitta))
    return _Skin(body, sides, x, on, sagitta)
