# SPDX-License-Identifier: MIT
"""Pointwise overlaps that the weighted gap averages out: a corner between coarse slave nodes."""

from collections.abc import Sequence
from dataclasses import replace

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import (
    Facets,
    are_inside,
    area_vectors,
    facet_normals,
    facet_sizes,
    points_of,
)
from dolfinx_mortar.geometry.segments import FACING
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tool import SidePattern, Tool, find_facing, point_gaps
from dolfinx_mortar.mortar.curvature_correction import point_heights, side_heights
from dolfinx_mortar.mortar.edges import SUNK
from dolfinx_mortar.mortar.pairing import received_facets
from dolfinx_mortar.mortar.passing import depth_of_point
from dolfinx_mortar.mortar.surface import accumulate, coordinates, facets_at
from dolfinx_mortar.mortar.whole_side import whole_facets
from dolfinx_mortar.newton_method.residuals import DIGIT

# Then the sagittas of facets are taken off so many times: of heights that are known at two points
# of Gauss, the end of a segment may have 1 / 0.79 of the larger one.
HIGHER = 2.0


def notes_on_overlaps(
    links: Sequence[Link],
    u: fem.Function,
    closed: Bools | None = None,
    rtol: float = 0.0,
) -> list[str]:
    """Return a note for each contact whose sides overlap deeply at some point; collective.

    The weighted gap of a node is a mean over its facets; a corner between the nodes is not in it,
    nor is a node on an axis, where functions of second order integrate to nothing.

    Args:
        closed: (owned nodes,) where contacts are; if given, one without any may overlap less.
        rtol: facet lengths by which a step lets sides overlap.
    """
    notes = []
    for link in links:
        if link.pairing:
            comm = link.sides.V.mesh.comm
            is_open = closed is not None and not any_rank(comm, closed[link.nodes].any())[0]
            # where no node is closed, no mean over facets with a force excuses an overlap: it is
            # what a step allows, with a digit for points beside the nodes
            notes += _note(link, u, rtol / DIGIT if is_open else None)
            notes += _note_on_poles(link, u, rtol) if is_open else []
        notes += _note_on_tool(link, u)
    return notes


def _note_on_tool(link: Link, u: fem.Function) -> list[str]:
    """Return the note on a tool that lies deep in its side between its points; collective."""
    if (tool := link.interface.tool) is None:
        return []
    ratio, deepest, x = find_deepest(link.sides.V.mesh.comm, *_depths(link, tool, u))
    if ratio <= SUNK:
        return []
    return [
        f"{link.interface}: around ({', '.join(f'{c:.4g}' for c in x)}) the tool lies "
        f"{deepest:.3g} deep in the side, {ratio:.0%} of a facet there: its gap is a mean over "
        "facets; refine there, or round a tool that is sharper than the facets"
    ]


def _depths(link: Link, tool: Tool, u: fem.Function) -> tuple[Floats, Floats, Floats]:
    """Return how deep points of integration and middles of facets are in a tool; collective.

    Depths over the length of their facets (q,), depths (q,) and points (q, d) at X + u. And how
    deep the tool lies below its own point, of the facet that is nearest to that along its normal: a
    ball may be smaller than what is between the others. Where nodes alone have distances, the tool
    lies less deep in facets by what the surface through the nodes bends away from it, as a bore
    from its shaft; that is taken in the middles of facets.
    """
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


def _note(link: Link, u: fem.Function, unseen: float | None) -> list[str]:
    """Return the note on one contact, if any; collective.

    Args:
        unseen: what an open contact may overlap, over the finer facet; None for one that is closed.
    """
    comm, smooth = link.sides.V.mesh.comm, link.pattern.smooth is not None
    least = SUNK if unseen is None or not smooth else min(unseen, SUNK)
    share, pair, depth, place = _find_overlaps(link, u, least)
    if smooth and any_rank(comm, share.max(initial=0.0) > least)[0]:
        sagittas = _sagittas(link, u)[pair]
        off = share - sagittas
        share = np.where(off > SUNK, off, share - HIGHER * sagittas)
    ratio, deepest, x = find_deepest(comm, share, depth, place)
    if ratio <= least:
        return []
    part = f"{ratio:.0%}" if ratio >= 0.01 else f"{ratio:.1g}"
    bare = link.prescribed_facets()[link.mortar[0].pairs[pair, 0]]
    why = (
        f"their gap is a mean over facets of slave={link.sides.slave.label}, of those at X with "
        "geometry='reference'; let the finer or sharper side be the slave, or refine there"
    )
    if find_deepest(comm, np.where(bare, share, 0.0), depth, place)[0] == ratio:
        why = (
            f"Dirichlet data prescribe the nodes of slave={link.sides.slave.label} there, so that "
            "none has a multiplier, and nothing holds the master; let the other side be the slave"
        )
    return [
        f"{link.interface}: around ({', '.join(f'{c:.4g}' for c in x)}) the sides lie "
        f"{deepest:.3g} deep in each other, {part} of the finer facet there: {why}"
    ]


def find_deepest(
    comm: MPI.Comm, share: Floats, depth: Floats, place: Floats
) -> tuple[float, float, list[float]]:
    """Return share, depth and place of the largest share of all ranks; 0 for none; collective."""
    mine = [(share[i], depth[i], place[i].tolist()) for i in np.argsort(share)[-1:]]
    everywhere = [found for rank in comm.allgather(mine) for found in rank]
    return max(everywhere, default=(0.0, 0.0, []))


def _note_on_poles(link: Link, u: fem.Function, rtol: float) -> list[str]:
    """Return the note on nodes on an axis that touch alone and have no multiplier; collective.

    Both sides have a vertex there, where smooth surfaces are as high as their facets.
    """
    pairing, comm = link.mortar[0], link.sides.V.mesh.comm
    slave, master = _facets(link, u)
    own = pairing.slave
    marks = np.zeros(len(own.nodes))
    marks[: own.owned] = link.coupling.coverage.weightless
    s, m = pairing.pairs.T
    poles = (accumulate(own, marks) > 0)[own.facets]
    meets = poles[s].any(axis=1)
    finer = _finer(link, slave, master)
    pairs = np.flatnonzero(meets).astype(np.int32)
    depth, pair, x = _vertices_in(slave, s[pairs], master, m[pairs], pairs, rtol * finer[pairs])
    at = np.einsum("mki,mk->mi", slave.x, poles / np.maximum(poles.sum(axis=1), 1)[:, None])
    there = np.linalg.norm(x - at[s[pair]], axis=1) <= HALF_OF_DIGITS * finer[pair]
    share = np.where(there & (depth < pairing.deepest[pair]), depth / finer[pair], 0.0)
    ratio, deepest, place = find_deepest(comm, share, depth, x)
    if ratio <= rtol:
        return []
    return [
        f"{link.interface}: at ({', '.join(f'{c:.4g}' for c in place)}) on the axis the sides lie "
        f"{deepest:.3g} deep in each other without a force: with displacements of degree 2 the "
        "node on the axis has no multiplier, and no other node is in contact; refine until others "
        "are, or take displacements of degree 1"
    ]


def _sagittas(link: Link, u: fem.Function) -> Floats:
    """Return how far (pairs,) facets of smooth sides stand off, over the finer one; collective."""
    pairing, segments = link.mortar[0], link.mortar[1].segments
    assert link.pattern.smooth is not None
    heights = point_heights(pairing, segments, u, link.pattern.smooth)
    result = np.zeros(len(pairing.pairs))
    np.maximum.at(result, segments.pair, np.abs(heights))
    slave, master = _facets(link, u)
    return result / _finer(link, slave, master)


def _facets(link: Link, u: fem.Function) -> tuple[Facets, Facets]:
    """Return the facets of the slave and the received ones of the master at X + u; collective."""
    pairing, _ = link.mortar
    return facets_at(pairing.slave, coordinates(pairing.slave, u)), received_facets(pairing, u)


def _finer(link: Link, slave: Facets, master: Facets) -> Floats:
    """Return the length of the smaller facet of each pair (pairs,)."""
    s, m = link.mortar[0].pairs.T
    return np.minimum(_lengths(slave)[s], _lengths(master)[m])


def _find_overlaps(link: Link, u: fem.Function, sunk: float) -> tuple[Floats, Ints, Floats, Floats]:
    """Return overlaps (p,) in parts of the finer facet, their pairs, depths and points (p, d).

    At the integration points of the segments, at vertices of each side over facets of the other
    where these may lie deeper than `sunk`, and where edges of both sides cross. Pairs of facets
    that face each other over less than `SUNK` of the smaller one are left out: a body's far side is
    paired so where its edges come to lie over the other body's. Collective.
    """
    pairing, segments = link.mortar[0], link.mortar[1].segments
    slave, master = _facets(link, u)
    finer, power = _finer(link, slave, master), slave.x.shape[2] - 1
    shared = np.bincount(segments.pair, segments.weight, minlength=len(finer))
    whole = (segments.facet_weights.sum(axis=1) / _lengths(slave) ** power)[pairing.pairs[:, 0]]
    faces = shared > SUNK * finer**power * whole
    x_s = points_of(slave, segments.slave, segments.xi_s)
    x_m = points_of(master, segments.master, segments.xi_m)
    n = facet_normals(master)[segments.master]
    pairs = np.flatnonzero(faces).astype(np.int32)
    s, m = pairing.pairs[pairs].T
    least = sunk * finer[pairs]
    found = [
        (((x_m - x_s) * n).sum(axis=1), segments.pair, x_s),
        _vertices_in(slave, s, master, m, pairs, least),
        _vertices_in(master, m, slave, s, pairs, least),
        *_crossing_edges(slave, s, master, m, pairs),
    ]
    depth, pair, x = (np.concatenate([part[i] for part in found]) for i in range(3))
    depth = np.where(faces[pair] & (depth < pairing.deepest[pair]), depth, 0.0)
    return depth / finer[pair], pair, depth, x


def _bows(facets: Facets) -> Floats:
    """Return how far (m,) nodes of facets lie off the plane through the middle of the vertices."""
    middle = facets.x[:, list(facets.element.vertices)].mean(axis=1, keepdims=True)
    off = np.einsum("mki,mi->mk", facets.x - middle, facet_normals(facets))
    return np.asarray(np.abs(off).max(axis=1, initial=0.0))


def _vertices_in(
    one: Facets, a: Ints, other: Facets, b: Ints, pairs: Ints, least: Floats
) -> tuple[Floats, Ints, Floats]:
    """Return depths (p,) of vertices of facets a below facets b, their pairs, and the points.

    Of those alone that may be deeper than the least (pairs,), so that few are located.
    """
    corners, normals = other.x[:, list(other.element.vertices)], facet_normals(other)
    middle, n, found = corners.mean(axis=1)[b], normals[b], []
    least = least - _bows(other)[b]
    for k in one.element.vertices:
        p = one.x[a, k]
        deep = np.flatnonzero(((middle - p) * n).sum(axis=1) > least)
        deep = deep[are_inside(corners[b[deep]], n[deep], p[deep])]
        p, facets, along = p[deep], other[b[deep]], n[deep]
        depth = ((opposite(facets, along, p) - p) * along).sum(axis=1)
        found.append((depth, pairs[deep], p))
    depths, which, points = zip(*found, strict=True)
    return np.concatenate(depths), np.concatenate(which), np.concatenate(points)


def opposite(facets: Facets, n: Floats, p: Floats) -> Floats:
    """Return where (m, d) lines through points p (m, d) along n (m, d) meet facets (m,).

    By Newton's method from the centre of the reference facet, until its steps shrink no more.
    """
    element, every = facets.element, np.arange(len(p), dtype=np.int32)
    xi = np.tile(element.points.mean(axis=0), (len(p), 1))
    last, longest = np.inf, 1.0
    while HALF_OF_DIGITS < longest < last:
        x = points_of(facets, every, xi)
        tangents = np.einsum("mka,mki->mia", element.derivatives(xi), facets.x)
        system = np.concatenate([tangents, n[:, :, None]], axis=2)
        step = np.linalg.solve(system, (p - x)[:, :, None])[:, :-1, 0]
        xi = xi + step
        last, longest = longest, float(np.abs(step).max(initial=0.0))
    return points_of(facets, every, xi)


def _crossing_edges(
    slave: Facets, s: Ints, master: Facets, m: Ints, pairs: Ints
) -> list[tuple[Floats, Ints, Floats]]:
    """Return depths (p,) of edges of facets s below those of facets m, as `_vertices_in` does.

    Along the common normal of two edges in space that leaves both facets, where they cross as seen
    along it. Left out are edges that are parallel but for `FACING`, and facets over which the gap
    changes by less than `SUNK` from an integration point to a corner, a quarter of their length.
    """
    n_s, n_m = facet_normals(slave)[s], facet_normals(master)[m]
    inclined = (n_s * n_m).sum(axis=1) > -np.sqrt(1.0 - (4 * SUNK) ** 2)
    if slave.x.shape[2] == 2 or not inclined.any():
        return []
    s, m, pairs = s[inclined], m[inclined], pairs[inclined]
    n_s, n_m = n_s[inclined], n_m[inclined]
    found = []
    for i, i_end in _edges(slave.element):
        p, dp = slave.x[s, i], slave.x[s, i_end] - slave.x[s, i]
        for j, j_end in _edges(master.element):
            q, dq = master.x[m, j], master.x[m, j_end] - master.x[m, j]
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


def _edges(element: FacetElement) -> list[tuple[int, int]]:
    """Return the nodes at the ends of edges; second-order ones are two, up to their middles."""
    n = len(element.vertices)
    ends = [(i, (i + 1) % n) for i in range(n)]
    if element.degree == 1:
        return ends
    return [half for i, end in ends for half in ((i, n + i), (n + i, end))]


def _lengths(facets: Facets) -> Floats:
    """Return the lengths (m,) of facets, in space the roots of their areas."""
    size = np.linalg.norm(area_vectors(facets), axis=1)
    return np.asarray(size ** (1 / (facets.x.shape[2] - 1)))
