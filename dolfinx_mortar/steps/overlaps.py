# SPDX-License-Identifier: MIT
"""Overlaps that multipliers do not see: a corner between the nodes of a coarse slave side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.geometry.facets import (
    Facets,
    are_inside,
    area_vectors,
    facet_normals,
    points_of,
)
from dolfinx_mortar.interfaces.coupling import Link
from dolfinx_mortar.mortar.pairing import received_facets
from dolfinx_mortar.mortar.smooth import point_heights
from dolfinx_mortar.mortar.surface import coordinates, facets_at

# Sides may lie so deep in each other, in parts of the finer facet. In 280 steps of the tests (pins,
# balls, blocks and sockets, elastic, plastic, with friction) they do by .04 at most, but for the
# sagittas of facets; a lost corner sinks in as far as it is pressed.
SUNK = 0.05


def notes_on_overlaps(links: Sequence[Link], u: fem.Function) -> list[str]:
    """Return a note for each contact whose sides lie deep in each other somewhere; collective.

    The gap of a node is a mean over its facets: it does not show a corner between the nodes.

    Args:
        links: the interfaces, coupled.
        u: displacement.
    """
    return [note for link in links if link.interface.one_sided for note in _note(link, u)]


def _note(link: Link, u: fem.Function) -> list[str]:
    """Return what to say of one contact, at most one note; collective."""
    comm = link.sides.V.mesh.comm
    share, pair, depth, place = _find_overlaps(link, u)
    if link.pattern.smooth is not None and any_rank(comm, share.max(initial=0.0) > SUNK)[0]:
        share = share - _sagittas(link, u)[pair]
    mine = [(share[i], depth[i], place[i].tolist()) for i in np.argsort(share)[-1:]]
    everywhere = [found for rank in comm.allgather(mine) for found in rank]
    ratio, deepest, x = max(everywhere, default=(0.0, 0.0, []))
    if ratio <= SUNK:
        return []
    return [
        f"{link.interface}: around ({', '.join(f'{c:.4g}' for c in x)}) the sides lie "
        f"{deepest:.3g} deep in each other, {ratio:.0%} of the finer facet there: nodes of "
        f"slave={link.sides.slave.label} do not see an edge or corner between them; let the finer "
        "or sharper side be the slave, or refine there"
    ]


def _sagittas(link: Link, u: fem.Function) -> Floats:
    """Return how far (pairs,) facets of smooth sides stand off, over the finer one; collective."""
    segments = link.coupling.segments
    assert link.pattern.smooth is not None
    heights = point_heights(link.pairing, segments, u, link.pattern.smooth)
    result = np.zeros(len(link.pairing.pairs))
    np.maximum.at(result, segments.pair, np.abs(heights))
    slave, master = _facets(link, u)
    return result / _finer(link, slave, master)


def _facets(link: Link, u: fem.Function) -> tuple[Facets, Facets]:
    """Return the facets of the slave and the received ones of the master at X + u; collective."""
    pairing = link.pairing
    return facets_at(pairing.slave, coordinates(pairing.slave, u)), received_facets(pairing, u)


def _finer(link: Link, slave: Facets, master: Facets) -> Floats:
    """Return the length of the smaller facet of each pair (pairs,)."""
    s, m = link.pairing.pairs.T
    return np.minimum(_lengths(slave)[s], _lengths(master)[m])


def _find_overlaps(link: Link, u: fem.Function) -> tuple[Floats, Ints, Floats, Floats]:
    """Return overlaps (p,) in parts of the finer facet, their pairs, depths and points (p, d).

    At the points of the segments, and at vertices of each side over facets of the other. By how
    much facets leave the plane of their vertices is no overlap. Collective.
    """
    pairing, segments = link.pairing, link.coupling.segments
    slave, master = _facets(link, u)
    x_s = points_of(slave, segments.slave, segments.xi_s)
    x_m = points_of(master, segments.master, segments.xi_m)
    n = facet_normals(master)[segments.master]
    pairs = np.unique(segments.pair)
    s, m = pairing.pairs[pairs].T
    found = [
        (((x_m - x_s) * n).sum(axis=1), segments.pair, x_s),
        _vertices_in(slave, s, master, m, pairs),
        _vertices_in(master, m, slave, s, pairs),
    ]
    depth, pair, x = (np.concatenate([part[i] for part in found]) for i in range(3))
    depth = np.where(depth < pairing.deepest[pair], depth, 0.0)
    bow = _bows(slave)[pairing.pairs[:, 0]] + _bows(master)[pairing.pairs[:, 1]]
    return (depth - bow[pair]) / _finer(link, slave, master)[pair], pair, depth, x


def _bows(facets: Facets) -> Floats:
    """Return how far (m,) nodes of facets lie off the plane through the middle of the vertices."""
    middle = facets.x[:, list(facets.element.vertices)].mean(axis=1, keepdims=True)
    off = np.einsum("mki,mi->mk", facets.x - middle, facet_normals(facets))
    return np.asarray(np.abs(off).max(axis=1, initial=0.0))


def _vertices_in(
    one: Facets, a: Ints, other: Facets, b: Ints, pairs: Ints
) -> tuple[Floats, Ints, Floats]:
    """Return depths (p,) of vertices of facets a below facets b, their pairs, and the points."""
    x, n = other.x[b][:, list(other.element.vertices)], facet_normals(other)[b]
    middle, found = x.mean(axis=1), []
    for k in one.element.vertices:
        p = one.x[a, k]
        inside = are_inside(x, n, p)
        depth = ((middle - p) * n).sum(axis=1)
        found.append((depth[inside], pairs[inside], p[inside]))
    depths, which, points = zip(*found, strict=True)
    return np.concatenate(depths), np.concatenate(which), np.concatenate(points)


def _lengths(facets: Facets) -> Floats:
    """Return the lengths (m,) of facets, in space the roots of their areas."""
    size = np.linalg.norm(area_vectors(facets), axis=1)
    return np.asarray(size ** (1 / (facets.x.shape[2] - 1)))
