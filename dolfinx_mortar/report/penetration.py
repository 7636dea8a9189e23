# SPDX-License-Identifier: MIT
"""Overlaps at corners between nodes, and of bodies without an interface."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.audit.neighbours import boxes_of
from dolfinx_mortar.geometry.elements import LINE2, TRI3
from dolfinx_mortar.geometry.facets import (
    Facets,
    are_inside,
    area_vectors,
    facet_normals,
    facet_sizes,
    points_of,
)
from dolfinx_mortar.geometry.flat import (
    Crossings,
    bounds,
    find_crossings,
    flat_parts,
    near_others,
    near_pairs,
)
from dolfinx_mortar.geometry.segments import FACING
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tool import SidePattern, Tool, find_facing, point_gaps
from dolfinx_mortar.mortar.curvature_correction import point_heights, side_heights
from dolfinx_mortar.mortar.pairing import received_facets
from dolfinx_mortar.mortar.passing import depth_of_point
from dolfinx_mortar.mortar.surface import accumulate, coordinates, facets_at, nodal_sagittas
from dolfinx_mortar.mortar.whole_side import whole_facets
from dolfinx_mortar.newton_method.residuals import DIGIT
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.step_report import Note

SUNK = 0.05
"""Share of the size of a facet up to which a corner may lie in it without a note.

In 280 steps of the tests (pins, balls, blocks and sockets, elastic, plastic, with friction) it is
.04 at most, apart from the sagittas of facets; a corner between nodes penetrates as far as it is
pressed.
"""
# Subtracted sagittas: known at two Gauss points, a height may be 1 / 0.79 of the larger at the
# segment's end.
HIGHER = 2.0
HELD = (
    "Dirichlet data prescribe all nodes of slave facets there, so that none has a multiplier, and "
    "nothing holds the master: let the other side be the slave"
)
MEAN = (
    "Gaps are means over facets of the slave, of those at X with geometry='reference': let the "
    "finer or sharper side be the slave, or refine there. With displacements of degree 2 a node on "
    "an axis has no multiplier: refine until others touch, or take degree 1. A tool that is "
    "sharper than the facets may be rounded"
)


def notes_on_overlaps(
    links: Sequence[Link],
    u: fem.Function,
    closed: Bools | None = None,
    rtol: float = 0.0,
) -> list[str]:
    """Note for each contact whose sides overlap deeply at some point; collective.

    Args:
        closed: (owned nodes,) contact; without any the check is stricter.
        rtol: overlap allowed by the step, in facet lengths.
    """
    notes = list[str]()
    for link in links:
        comm, tool = link.sides.V.mesh.comm, link.interface.tool
        found = None if tool is None else _depths(link, tool, u)
        bare: Bools = np.zeros(0, dtype=bool)
        if link.pairing:
            is_open = closed is not None and not any_rank(comm, closed[link.nodes].any())[0]
            # only a closed node excuses more overlap than the step's tolerance, with a digit for
            # points beside nodes
            *parts, bare = _find_overlaps(link, u, rtol / DIGIT if is_open else SUNK)
            found = parts[0], parts[1], parts[2]
        elif found is not None:
            found = np.where(found[0] > SUNK, found[0], 0.0), found[1], found[2]
        if found is None:
            continue
        ratio, deepest, x = _deepest(comm, *found) or (0.0, 0.0, [])
        if ratio > 0.0:
            held = _deepest(comm, found[0] * bare)[0] if link.pairing else 0.0
            part = f"{ratio:.0%}" if ratio >= 0.01 else f"{ratio:.1g}"
            seen = (
                f"{link.interface}: around ({', '.join(f'{c:.4g}' for c in x)}) the sides lie "
                f"{deepest:.3g} deep in each other, {part} of the finer facet there"
            )
            notes.append(Note(seen, HELD if held == ratio else MEAN))
    return notes


def _depths(link: Link, tool: Tool, u: fem.Function) -> tuple[Floats, Floats, Floats]:
    """Depths (p,) in a tool over facet sizes, depths, points (p, d) between nodes; collective."""
    assert isinstance(link.pattern, SidePattern) and link.pattern.side is not None
    side, pose, x = link.pattern.side, tool.pose(), coordinates(link.sides.slave, u)
    facing = find_facing(side, pose, tool.asked, x)
    segments, points = whole_facets(side, x, facing)
    own, nodal = link.pattern.own, link.pattern.nodal
    pattern = replace(link.pattern, nodal=False, own=None if nodal else own)
    gaps, _ = point_gaps(pattern, pose, tool.asked, u, segments, points)
    nodes = x[side.slave.facets]
    sizes, middles = facet_sizes(nodes), nodes.mean(axis=1)[facing]
    facets = facets_at(side.slave, x)
    less = np.zeros(len(sizes))
    if nodal and own is not None:
        at = np.tile(facets.element.points.mean(axis=0), (len(sizes), 1))
        every = np.arange(len(sizes), dtype=np.int32)
        less[:] = np.minimum(side_heights(side.slave, own, u, every, at), 0.0)
    corners, n = nodes[:, list(facets.element.vertices)], facet_normals(facets)
    point = np.broadcast_to(pose.to_space(tool.asked.point[None]), (len(n), x.shape[1]))
    above = ((point - corners.mean(axis=1)) * n).sum(axis=1)
    below = depth_of_point(link.sides.V.mesh.comm, tool.seen()) - above
    met = (above >= -sizes) & (below > 0.0) & are_inside(corners, n, point)
    depth = -np.concatenate([gaps, pose.distance(tool.asked, middles).value, -below[met]])
    which = np.concatenate([segments.slave, np.flatnonzero(facing), np.flatnonzero(met)])
    depth = depth + less[which]
    return depth / sizes[which], depth, np.concatenate([points, middles, point[met]])


def _deepest(comm: MPI.Comm, *columns: Any) -> Any:
    """Columns where the first one is largest over all ranks; collective."""
    mine = [[column[i].tolist() for column in columns] for i in np.argsort(columns[0])[-1:]]
    return max((found for rank in comm.allgather(mine) for found in rank), default=None)


def _find_overlaps(
    link: Link, u: fem.Function, unseen: float
) -> tuple[Floats, Floats, Floats, Bools]:
    """Overlaps (p,) over the finer facet, depths, points (p, d), mask of prescribed slave facets.

    Pairs that share less than `SUNK` of the smaller facet, as of a body's far side, and values
    below `unseen` (with facets `SUNK`) are left out.
    """
    pairing, segments = link.mortar[0], link.mortar[1].segments
    own, smooth, (s, m) = pairing.slave, link.pattern.smooth, pairing.pairs.T
    slave, master = facets_at(own, coordinates(own, u)), received_facets(pairing, u)
    power = slave.x.shape[2] - 1
    of_slave = _lengths(slave)
    finer = np.minimum(of_slave[s], _lengths(master)[m])
    shared = np.bincount(segments.pair, segments.weight, minlength=len(finer))
    whole = (segments.facet_weights.sum(axis=1) / of_slave**power)[s]
    faces = shared > SUNK * finer**power * whole
    x_s = points_of(slave, segments.slave, segments.xi_s)
    x_m = points_of(master, segments.master, segments.xi_m)
    n = facet_normals(master)[segments.master]
    pairs = np.flatnonzero(faces).astype(np.int32)
    least = unseen * finer[pairs]
    found = [
        (((x_m - x_s) * n).sum(axis=1), segments.pair, x_s),
        _vertices_in(slave, s[pairs], master, m[pairs], pairs, least),
        _vertices_in(master, m[pairs], slave, s[pairs], pairs, least),
        *_crossing_edges(slave, s[pairs], master, m[pairs], pairs),
    ]
    depth, pair, x = (np.concatenate([part[i] for part in found]) for i in range(3))
    share = np.where(faces[pair] & (depth < pairing.deepest[pair]), depth / finer[pair], 0.0)
    marks = np.zeros(len(own.nodes))
    marks[: own.owned] = link.coupling.coverage.weightless
    poles = (accumulate(own, marks) > 0)[own.facets]
    at = np.einsum("mki,mk->mi", slave.x, poles / np.maximum(poles.sum(axis=1), 1)[:, None])
    away = np.linalg.norm(x - at[s[pair]], axis=1) > HALF_OF_DIGITS * finer[pair]
    off_axis = away | ~np.asarray(poles.any(axis=1))[s[pair]]
    if smooth is not None:
        heights = point_heights(pairing, segments, u, smooth)
        sagittas = np.zeros(len(finer))
        np.maximum.at(sagittas, segments.pair, np.abs(heights))
        share = share - off_axis * HIGHER * (sagittas / finer)[pair]
    limit = np.where(off_axis & (smooth is None), SUNK, min(unseen, SUNK))
    return np.where(share > limit, share, 0.0), depth, x, link.prescribed_facets()[s[pair]]


def _vertices_in(
    one: Facets, a: Ints, other: Facets, b: Ints, pairs: Ints, least: Floats
) -> tuple[Floats, Ints, Floats]:
    """Depths (p,) of vertices of facets a below flat facets b, less their bow; pairs; points."""
    corners, n = other.x[:, list(other.element.vertices)], facet_normals(other)
    middle, found = corners.mean(axis=1), []
    bows = np.abs(np.einsum("mki,mi->mk", other.x - middle[:, None], n)).max(axis=1, initial=0.0)
    for k in one.element.vertices:
        p = one.x[a, k]
        depth = ((middle[b] - p) * n[b]).sum(axis=1) - bows[b]
        deep = np.flatnonzero(depth > least)
        deep = deep[are_inside(corners[b[deep]], n[b[deep]], p[deep])]
        found.append((depth[deep], pairs[deep], p[deep]))
    depths, which, points = zip(*found, strict=True)
    return np.concatenate(depths), np.concatenate(which), np.concatenate(points)


def _crossing_edges(
    slave: Facets, s: Ints, master: Facets, m: Ints, pairs: Ints
) -> list[tuple[Floats, Ints, Floats]]:
    """Depths (p,) of edges of facets s below those of m along the normal of both; pairs; points."""
    n_s, n_m = facet_normals(slave)[s], facet_normals(master)[m]
    inclined = (n_s * n_m).sum(axis=1) > -np.sqrt(1.0 - (4 * SUNK) ** 2)
    if slave.x.shape[2] == 2 or not inclined.any():
        return []
    s, m, pairs = s[inclined], m[inclined], pairs[inclined]
    n_s, n_m = n_s[inclined], n_m[inclined]
    found, (x, y) = [], (f.x[k][:, list(f.element.vertices)] for f, k in ((slave, s), (master, m)))
    for i in range(x.shape[1]):
        p, dp = x[:, i], x[:, i - 1] - x[:, i]
        for j in range(y.shape[1]):
            q, dq = y[:, j], y[:, j - 1] - y[:, j]
            n = np.cross(dp, dq)
            square = (n * n).sum(axis=1)
            some = square > (FACING * np.linalg.norm(dp, axis=1) * np.linalg.norm(dq, axis=1)) ** 2
            ratios = np.divide(1.0, square, out=np.zeros_like(square), where=some)
            at_p = (np.cross(q - p, dq) * n).sum(axis=1) * ratios
            at_q = (np.cross(q - p, dp) * n).sum(axis=1) * ratios
            some &= (np.abs(at_p - 0.5) <= 0.5) & (np.abs(at_q - 0.5) <= 0.5)
            n *= (np.sign((n * n_m).sum(axis=1)) * np.sqrt(ratios))[:, None]
            some &= ((n * n_m).sum(axis=1) > FACING) & ((n * n_s).sum(axis=1) < -FACING)
            depth = ((q - p) * n).sum(axis=1)
            found.append((depth[some], pairs[some], (p + at_p[:, None] * dp)[some]))
    return found


def _lengths(facets: Facets) -> Floats:
    """Lengths (m,) of facets, in space roots of their areas."""
    size = np.linalg.norm(area_vectors(facets), axis=1)
    return np.asarray(size ** (1 / (facets.x.shape[2] - 1)))


@dataclass(frozen=True)
class Crossing:
    """Deepest crossing of boundaries without an interface."""

    share: float = 0.0  # depth over the smaller facet
    depth: float = 0.0
    place: Sequence[float] = ()
    bodies: Sequence[int] = ()


@dataclass(frozen=True)
class _Skin:
    """Flat facets near other bodies, or on surfaces in self-contact."""

    body: Longs  # (m,)
    sides: Bools  # (m, 2, interfaces) on its slave and its master side
    on: Bools  # (m, d, 2, interfaces) the same for vertices
    x: Floats  # (m, d, d)
    sagitta: Floats  # (m,) of the interface sides on or next to which they are

    def __getitem__(self, which: Bools | Longs) -> "_Skin":
        return _Skin(*(getattr(self, f.name)[which] for f in fields(self)))

    @property
    def normals(self) -> Floats:
        return facet_normals(Facets(LINE2 if self.x.shape[2] == 2 else TRI3, self.x))

    def received(self, comm: MPI.Comm) -> "_Skin":
        """Own facets, and those of other ranks in their box; collective."""
        low, high = bounds(self.x)
        box = low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf)
        sent = [
            self[((low <= most) & (high >= least)).all(axis=1) & (rank != comm.rank)]
            for rank, (least, most) in enumerate(comm.allgather(box))
        ]
        parts = [self, *comm.alltoall(sent)]
        return _Skin(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(self)))

    def pairs(self, meets_itself: Bools) -> Longs:
        """Pairs (p, 2) of near facets of two bodies, or in self-contact, without an interface."""
        count = int(self.body.max(initial=-1)) + 1
        own = np.zeros(count, dtype=bool)
        surface = self.sides.any(axis=1) & meets_itself
        own[self.body[surface.any(axis=1)]] = True
        pairs = near_pairs(self.x, self.body, ~np.eye(count, dtype=bool) | np.diag(own))
        (one, other), n = pairs.T, self.normals
        coupled = (self.sides[one] & self.sides[other][:, ::-1]).any(axis=(1, 2))
        coupled &= (n[one] * n[other]).sum(axis=1) < -HALF_OF_DIGITS
        alike = (self.body[one] == self.body[other]) & ~(surface[one] & surface[other]).any(axis=1)
        return pairs[~(coupled | alike)]


def find_crossing(problem: ContactProblem) -> Crossing:
    """Deepest crossing of the boundaries of bodies at X + u; collective.

    Of two bodies, or a surface in self-contact; minus jumps of ties, and sagittas of both sides, as
    facets count as flat.
    """
    meets_itself: Bools = np.array([s.meet_themselves for s in problem.system.sides], dtype=bool)
    if problem.bodies.count == 1 and not meets_itself.any():
        return Crossing()
    comm, own = problem.comm, _create_skin(problem, meets_itself)
    skin = own.received(comm)
    found = find_crossings(skin.x, skin.pairs(meets_itself))
    found = found.part(found.pairs[:, 1] < len(own.body))  # has all facets at the edge
    one, other = skin[found.pairs[:, 0]], skin[found.pairs[:, 1]]
    reach = np.minimum(_seen_reach(one, other), _seen_reach(other, one))
    reach = np.where(one.body == other.body, np.inf, reach)
    tied = (_touched(one) & _touched(other)[:, ::-1]).any(axis=1)
    meant = (tied * _longest_jumps(problem)).max(axis=1, initial=0.0)
    deep = np.minimum(found.depth, _from_seen_edges(found.place, one, other))
    depth = np.minimum(deep - one.sagitta - other.sagitta, reach) - meant
    depth = _least_at_edges(found, depth.clip(min=0.0))
    share = depth / np.minimum(facet_sizes(one.x), facet_sizes(other.x))
    columns = share, depth, found.place, np.stack([one.body, other.body], axis=1)
    return Crossing(*(_deepest(comm, *columns) or ()))


def _least_at_edges(found: Crossings, depth: Floats) -> Floats:
    """Least depth (p,) of facets that share an edge, lest round-off along a flank count."""
    edges = np.column_stack([found.ends, found.pairs[:, 1]])
    _, edge = np.unique(edges, axis=0, return_inverse=True)
    least = np.full(len(depth), np.inf)
    np.minimum.at(least, edge.ravel(), depth)
    return least[edge.ravel()]


def _seen_reach(one: _Skin, other: _Skin) -> Floats:
    """Extent (m,) of facets behind others, infinite unless an interface sees their nodes."""
    behind = -np.einsum("mkd,md->mk", other.x - one.x[:, :1], one.normals)
    seen = (one.sides[:, None] & other.on[:, :, ::-1]).any(axis=(2, 3))
    return np.where(seen | (behind <= 0.0), behind, np.inf).max(axis=1, initial=0.0)


def _from_seen_edges(place: Floats, one: _Skin, other: _Skin) -> Floats:
    """Distance (m,) of crossings from edges seen by an interface, else infinity."""
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


def _touched(skin: _Skin) -> Bools:
    """Mask (m, 2, interfaces) of sides on or next to which facets are."""
    return np.asarray(skin.on.any(axis=1))


def _longest_jumps(problem: ContactProblem) -> Floats:
    """Length of the jump of each interface; collective."""
    apart = [link.apart() for link in problem.system.links]
    lengths = [0.0 if v is None else np.linalg.norm(v, axis=1).max(initial=0.0) for v in apart]
    none = np.zeros(len(problem.system.sides))
    return np.asarray(maximum(problem.comm, *lengths)) if lengths else none


def notes_on_crossings(problem: ContactProblem, found: Crossing) -> list[str]:
    """Note if boundaries cross by more than the discretisation explains."""
    if found.share <= SUNK:
        return []
    centres = problem.bodies.centre[list(found.bodies)]
    where, *around = (
        f"({', '.join(f'{c:.4g}' for c in x)})" for x in (np.array(found.place), *centres)
    )
    itself = len(set(found.bodies)) == 1
    who = f"the surface of the body around {around[0]} lies in itself"
    if not itself:
        who = f"the bodies around {around[0]} and {around[1]} lie in each other"
    seen = (
        f"{who} around {where}, where no interface couples them: by {found.depth:.3g}, "
        f"{found.share:.0%} of a facet there"
    )
    why = (
        "Its contact with itself has no pairs there: take smaller steps, finer facets, or a tag "
        "for each of the parts"
    )
    if not itself:
        why = (
            "Give them a Contact, or add these facets to the sides of one; where sides run around "
            "a body that is thinner than twice the overlap, tag only faces that touch"
        )
    return [Note(seen, why)]


def _create_skin(problem: ContactProblem, meets_itself: Bools) -> _Skin:
    """Exterior facets of this rank that may cross others; collective."""
    boundary, interfaces = problem.system.boundary, problem.system.sides
    facets, nodes = boundary.at(problem.u), boundary.nodes
    body = problem.bodies.of_cells[boundary.cells].astype(np.int64)
    sides = np.zeros((len(body), 2, len(interfaces)), dtype=bool)
    index_map, count = problem.V.dofmap.index_map, 2 * len(interfaces)
    values = la.vector(index_map, 1 + count)
    values.array[:] = 0.0
    at = values.array.reshape(-1, 1 + count)
    for k, interface in enumerate(interfaces):
        for j, surface in enumerate(interface.surfaces):
            sides[:, j, k] = np.isin(boundary.entities, surface.entities)
            own = surface.nodes[: surface.owned]
            sagittas = nodal_sagittas(surface, coordinates(surface, problem.u))[: surface.owned]
            at[own, 0] = np.maximum(at[own, 0], sagittas)
            at[own, 1 + j * len(interfaces) + k] = 1.0
    for k in np.flatnonzero(meets_itself):
        pairing = problem.system.links[k].pairing
        assert pairing is not None and pairing.roles is not None
        slaves = interfaces[k].slave.entities[pairing.roles.slave]
        sides[:, 0, k] = np.isin(boundary.entities, slaves)
        sides[:, 1, k] &= ~sides[:, 0, k]
    values.scatter_forward()
    boxes = boxes_of(problem.comm, facets.x, body, problem.bodies.count)
    near = near_others(facets.x, body, boxes) | (sides.any(axis=1) & meets_itself).any(axis=1)
    x, count = flat_parts(facets[near]), int(near.sum())
    again = np.arange(len(x)) % max(count, 1)
    flat = flat_parts(Facets(facets.element, at[nodes[near]]))
    on = flat[:, :, 1:].reshape(*flat.shape[:2], *sides.shape[1:]) > 0.0
    sagitta = at[nodes[near], 0].max(axis=1, initial=0.0)[again]
    return _Skin(body[near][again], sides[near][again], on, x, sagitta)
