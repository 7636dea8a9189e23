# SPDX-License-Identifier: MIT
r"""Derivatives of contact forces and of weighted gaps in 3D, when both sides move.

As in `dolfinx_mortar.mortar.derivatives`, with which the definitions and the result are common.
Facets are projected along the mean normals of their parts, so that the averaged normals n direct
the tractions and the gaps alone. What belongs to the points of one pair is integrated by compiled
kernels, `dolfinx_mortar.geometry.facet_derivatives`; the coefficients of the dual functions of a
facet change with the weights at the points of all its pairs. On flat triangles that are covered
without a free edge they do not: their moments have the factor of all weights in common.

Held are edges that one master facet casts on another one behind it, jumps of heights between
master facets, and in second order the strain of the bodies along the normal, a factor of the height
of a smooth surface (`dolfinx_mortar.mortar.curvature_correction.point_heights`).
"""

import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.algebra.block_sums import Blocks, Matrix
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.facet_derivatives import (
    Coefficients,
    Integrands,
    PairIntegrals,
    Points,
    differentiate_integrals,
    differentiate_pairs,
    place_on_edges,
)
from dolfinx_mortar.geometry.facets import Facets, facet_normals, normal_slopes, points_of
from dolfinx_mortar.geometry.segments import Segments, are_facing
from dolfinx_mortar.mortar.curvature_correction import distinct, point_heights
from dolfinx_mortar.mortar.derivatives import Derivatives, Part, Tractions, by_closed_parts, summed
from dolfinx_mortar.mortar.duals import absorbed, find_duals, weighted_duals
from dolfinx_mortar.mortar.edges import PartlyOpen, Sharing, find_partly_open
from dolfinx_mortar.mortar.integrals import some_points, sums_of_products
from dolfinx_mortar.mortar.operators import SmoothSides
from dolfinx_mortar.mortar.pair_heights import pair_heights
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import coordinates, facets_at


@timed("~Mortar: derivatives")
def differentiate_in_space(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    keep: Bools,
    Phi: Floats,
    given: Tractions,
    smooth: SmoothSides | None = None,
    sharing: Sharing | None = None,
) -> Derivatives:
    """Return the derivatives of forces and weighted gaps at X + u (collective).

    The arguments are those of `dolfinx_mortar.mortar.derivatives.differentiate`, of surfaces in 3D;
    smooth surfaces by themselves. Functions that are shared out in part are sums of those that are
    and those that are not, each with a share that depends on the opening.
    """
    if sharing is None:
        return _differentiate(pairing, u, segments, keep, Phi, given, smooth)
    heights = np.zeros(len(segments.pair))
    if smooth is not None:
        heights = point_heights(pairing, segments, u, smooth)
    F_c, G_c = by_closed_parts(pairing, u, segments, keep, sharing, given, heights)
    by_x = _closed_parts(pairing, u, segments, find_partly_open(pairing, segments, u, sharing))
    F: list[Part] = [Matrix(F_c @ by_x)]
    G: list[Part] = [Matrix(G_c @ by_x)]
    F_n: list[Part] = []
    G_n: list[Part] = []
    for kept, share in ((keep, sharing.closed), (keep | sharing.silent, 1.0 - sharing.closed)):
        some = some_points(segments, share[segments.slave] > 0.0)
        Phi = weighted_duals(pairing, some, kept)
        parts = _differentiate(pairing, u, some, kept, Phi, given, smooth, share)
        F += parts.F_x
        G += parts.G_x
        F_n += parts.F_n
        G_n += parts.G_n
    return Derivatives(F, F_n, G, G_n)


def facing_derivatives(
    pairing: Pairing, u: dolfinx.fem.Function, segments: Segments, Phi: Floats, normals: Floats
) -> Blocks:
    """Return the derivatives of sum_l M_jl n_l by the coordinates, as points slide; collective.

    With d eta^a = m^a.(dx_s - dx_m), m^a dual to the tangents of the master across the normal of
    the slave facet (in second order of all its parts). Left out are the changes of w Phi_j, in
    which what n_l have in common does not turn b_j.

    Args:
        Phi: (q, k) weighted dual functions.
        normals: n_l (nm, 3) of the received master nodes, fixed.
    """
    slave, master = pairing.slave, received_facets(pairing, u)
    used, of = distinct(segments.pair)
    pairs = np.ascontiguousarray(pairing.pairs[used])
    m, element = segments.master, master.element
    slopes = element.derivatives(segments.xi_m)
    x, y = np.moveaxis(np.swapaxes(master.x[m], 1, 2) @ slopes, 2, 0)
    n = facet_normals(facets_at(slave, coordinates(slave, u)))[segments.slave]
    dual = np.stack([np.cross(y, n), np.cross(n, x)], axis=1)
    dual /= (x * dual[:, 0]).sum(axis=1)[:, None, None]
    turned = np.swapaxes(normals[pairing.master_facets][m], 1, 2) @ slopes @ dual
    N = [slave.element.shape_functions(segments.xi_s), -element.shape_functions(segments.xi_m)]
    columns = turned[:, :, None] * np.hstack(N)[:, None, :, None]  # (q, 3, k + l, 3)
    size = columns.shape[1:]
    sums = sums_of_products(
        Phi, columns.reshape(len(m), int(np.prod(size))), of.astype(np.int32), len(pairs)
    )
    place = _Places(pairing, pairs, len(slave.nodes))
    return Blocks(place.slave, place.nodes, sums.reshape(*sums.shape[:2], *size))


def _differentiate(
    pairing: Pairing,
    u: dolfinx.fem.Function,
    segments: Segments,
    keep: Bools,
    Phi: Floats,
    given: Tractions,
    smooth: SmoothSides | None,
    share: Floats | None = None,
) -> Derivatives:
    """Return the derivatives for the dual functions of some nodes; collective.

    Args:
        share: Factor (m,) of the functions on each slave facet; None for 1.
    """
    slave, master = pairing.slave, received_facets(pairing, u)
    facets, nodes = facets_at(slave, coordinates(slave, u)), slave.facets
    used, of = distinct(segments.pair)
    pairs = np.ascontiguousarray(pairing.pairs[used])
    edges = place_on_edges(facets, master, pairs, _free_edges(pairing, facets, master, pairs))
    inner = Points(of.astype(np.int64), segments.xi_s, segments.xi_m, segments.weight)
    sagittas, heights, h = None, None, None
    if smooth is not None:
        sagittas = pair_heights(pairing, used, u, smooth)
        at_inner, at_edges = (sagittas.at(at.pair, at.xi_s, at.xi_m) for at in (inner, edges))
        heights, h = (at_inner, at_edges), at_inner.h
    kept = keep[nodes]
    duals = find_duals(pairing, segments, keep)
    own = _Own(segments, inner, len(pairs), facets, master, duals.N, Phi, h)
    slave_of = pairs[edges.pair, 0]
    N = facets.element.shape_functions(edges.xi_s)
    N = np.ascontiguousarray(absorbed(facets.element.shares, N, kept[slave_of]))
    on_edges = duals.at(slave_of, N) * edges.weight[:, None]
    which = np.full(len(nodes), facets.element.bilinear or facets.element.degree > 1)
    which[pairs[edges.pair[edges.free], 0]] = True
    vectors = Integrands(given.tractions[nodes], given.normals[nodes])
    found = differentiate_pairs(
        facets,
        master,
        pairs,
        (inner, edges),
        (np.ascontiguousarray(Phi), on_edges),
        (np.ascontiguousarray(duals.N), N),
        vectors,
        Coefficients(which, duals.inverse, own.gaps(vectors.n)),
        heights,
    )
    gaps = found.gaps
    if sagittas is not None and sagittas.by_x is not None:
        gaps = gaps - sagittas.integrals(Phi, of.astype(np.int32), segments.xi_s, segments.xi_m)
    place = _Places(pairing, pairs, len(slave.nodes))
    part = np.ones(len(pairs)) if share is None else share[pairs[:, 0]]
    forces = _add_dual_changes(found, own, pairs[:, 0], which) * part[:, None, None, None, None]
    F: list[Part] = [Blocks(place.nodes, place.nodes, forces)]
    if len(found.with_edges):
        F.append(_by_edges(place, found, own, part))
    G = Blocks(place.slave, place.nodes, (gaps * part[:, None, None, None])[:, :, None])
    F_n, G_n = _by_normals(place, own, given, part)
    return Derivatives(F, [F_n], [G], [G_n])


def _closed_parts(
    pairing: Pairing, u: dolfinx.fem.Function, segments: Segments, partly: PartlyOpen
) -> Matrix:
    """Return the derivatives (m, 3 n + 3 nm) of the parts that facets share out; collective."""
    slave, master = pairing.slave, received_facets(pairing, u)
    facets = facets_at(slave, coordinates(slave, u))
    m, k = slave.facets.shape
    node, opening, by_moment = np.zeros(m, dtype=np.int32), np.zeros(m), np.zeros(m)
    node[partly.facets], opening[partly.facets] = partly.node, partly.opening
    by_moment[partly.facets] = partly.by_moment
    segments = some_points(segments, by_moment[segments.slave] != 0.0)
    used, of = distinct(segments.pair)
    pairs = np.ascontiguousarray(pairing.pairs[used])
    edges = place_on_edges(facets, master, pairs, _free_edges(pairing, facets, master, pairs))
    inner = Points(of.astype(np.int64), segments.xi_s, segments.xi_m, segments.weight)
    N, on = (np.clip(slave.element.shape_functions(at.xi_s), 0.0, None) for at in (inner, edges))
    at = facets, master, pairs, (inner, edges), (N, on), facet_normals(facets), opening
    p, s = np.arange(len(pairs)), pairs[:, 0]
    values = differentiate_integrals(*at)[p, node[s]]  # (p, k + l, 3)
    o = points_of(master, segments.master, inner.xi_m) - points_of(
        facets, segments.slave, inner.xi_s
    )
    moved = sums_of_products(N * inner.weight[:, None], o, of.astype(np.int32), len(pairs))
    turned = np.einsum("pi,pkih->pkh", moved[p, node[s]], normal_slopes(facets[s]))
    values[:, :k] += turned
    place = _Places(pairing, pairs, len(slave.nodes))
    size = m, place.columns
    by_moments = summed(s[:, None, None], place.dofs, by_moment[s, None, None] * values, size)
    own = 3 * slave.facets[partly.facets][:, :, None] + np.arange(3)
    return Matrix(by_moments + summed(partly.facets[:, None, None], own, partly.by_x, size))


def _free_edges(pairing: Pairing, slave: Facets, master: Facets, pairs: Ints) -> Bools:
    """Return the edges (p, l) of master facets beyond which no other one faces the slave facet."""
    count = len(master.x)
    beside = _neighbours(pairing.master_facets[:, list(master.element.vertices)])[pairs[:, 1]]
    s, m = pairing.pairs.T
    facing = are_facing(facet_normals(slave)[s][:, None], facet_normals(master)[m])
    known = (s.astype(np.int64) * count + m)[facing]
    asked = pairs[:, 0].astype(np.int64)[:, None] * count + beside
    return (beside < 0) | ~np.isin(asked, known)


def _neighbours(facets: Ints) -> Ints:
    """Return the facets (m, l) beyond the edges of facets, -1 where there is none.

    >>> _neighbours(np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32)).tolist()
    [[-1, 1, -1], [0, -1, -1]]
    """
    count, sides = facets.shape
    ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2).reshape(-1, 2)
    low, high = ends.min(axis=1).astype(np.int64), ends.max(axis=1)
    key = low * (int(facets.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(np.diff(key[order]) == 0)
    a, b = order[same], order[same + 1]
    result = np.full(count * sides, -1, dtype=np.int32)
    result[a], result[b] = b // sides, a // sides
    return result.reshape(count, sides)


class _Own:
    """Integrals over pairs (p,) and facets (f,) that derivatives by normals and weights need."""

    def __init__(
        self,
        segments: Segments,
        points: Points,
        p: int,
        slave: Facets,
        master: Facets,
        N: Floats,
        Phi: Floats,
        heights: Floats | None,
    ) -> None:
        pair, facet, f = points.pair.astype(np.int32), segments.slave, len(slave.x)
        N_s, N_m = (
            side.element.shape_functions(xi)
            for side, xi in ((slave, points.xi_s), (master, points.xi_m))
        )
        wN = N * points.weight[:, None]
        o = points_of(master, segments.master, points.xi_m)
        o -= points_of(slave, facet, points.xi_s)
        self.D = sums_of_products(Phi, N_s, pair, p)  # (p, k, k) int Phi_j N_k
        self.M = sums_of_products(Phi, N_m, pair, p)  # (p, k, l) int Phi_j N_l
        self.v = sums_of_products(Phi, o, pair, p)  # (p, k, 3) int Phi_j o
        self.N_s = sums_of_products(wN, N_s, pair, p)  # (p, k, k) int N~_b N_k
        self.N_m = sums_of_products(wN, N_m, pair, p)  # (p, k, l) int N~_b N_l
        self.o = sums_of_products(wN, o, facet, f)  # (f, k, 3) int N~_b o
        h = np.zeros((len(pair), 1)) if heights is None else heights[:, None]
        self.h = sums_of_products(wN, h, facet, f)[:, :, 0]  # (f, k) int N~_b h

    def gaps(self, n: Floats) -> Floats:
        """Return int N~_b (n_j.o - h) (f, k, k) for vectors n_j (f, k, 3)."""
        return np.asarray(n @ np.swapaxes(self.o, 1, 2) - self.h[:, None])

    @property
    def by_duals(self) -> Floats:
        """The forces (p, k, k + l) of N~_b as a traction."""
        return np.concatenate([self.N_s, -self.N_m], axis=2)


class _Places:
    """Where the integrals over pairs stand in the matrices of a rank."""

    def __init__(self, pairing: Pairing, pairs: Ints, n: int) -> None:
        self.n, self.columns = n, 3 * (n + len(pairing.master_nodes))
        self.facet, self.facets = pairs[:, 0], pairing.slave.facets
        self.slave = self.facets[self.facet]
        both = [self.slave, n + pairing.master_facets[pairs[:, 1]]]
        self.nodes = np.concatenate(both, axis=1)  # (p, k + l)
        self.k = self.slave.shape[1]

    @property
    def dofs(self) -> Ints:
        """Components (p, k + l, 3) of the nodes of pairs."""
        return 3 * self.nodes[:, :, None] + np.arange(3, dtype=np.int32)


def _add_dual_changes(found: PairIntegrals, own: _Own, facet: Ints, which: Bools) -> Floats:
    """Return the derivatives of forces (p, k + l, 3, k + l, 3), of changing dual functions, too.

    Without those by the master's nodes, which `_by_edges` returns.

    Args:
        found: those at fixed coefficients of the functions.
        own: integrals.
        facet: slave facets (p,) of the pairs.
        which: facets of which the functions change.
    """
    some = np.flatnonzero(which[facet])
    p, k, size = len(some), own.o.shape[1], found.forces.shape[1]
    by_b = np.swapaxes(own.by_duals[some], 1, 2)[:, None]  # (p, 1, k + l, k)
    change = by_b @ found.by_slave.reshape(-1, 3, k, 3 * k)[facet[some]]
    forces = found.forces
    forces[some, :, :, :k] += np.swapaxes(change, 1, 2).reshape(p, size, 3, k, 3)
    return forces


def _by_edges(place: "_Places", found: PairIntegrals, own: _Own, part: Floats) -> Matrix:
    """Return the derivatives of forces by the master's nodes of pairs with edges, by C_b.

    Times the parts (p,) of pairs.
    """
    k, on = place.k, found.with_edges
    xyz = np.arange(3, dtype=np.int32)
    item = 3 * (k * place.facet[:, None] + np.arange(k, dtype=np.int32))[:, :, None] + xyz
    count = 3 * k * len(place.facets)
    edged = np.isin(place.facet, place.facet[on])
    forces = np.repeat(np.swapaxes(own.by_duals[edged], 1, 2)[:, :, None], 3, axis=2)
    rows, columns = place.dofs[edged][..., None], np.swapaxes(item[edged], 1, 2)[:, None]
    F_C = summed(rows, columns, forces, (place.columns, count))
    columns = place.dofs[on][:, None, None, k:]
    rows = np.swapaxes(item[on], 1, 2)[..., None, None]
    values = found.by_master * part[on][:, None, None, None, None]
    return Matrix(F_C @ summed(rows, columns, values, (count, place.columns)))


def _by_normals(place: _Places, own: _Own, given: Tractions, part: Floats) -> tuple[Blocks, Blocks]:
    """Return the derivatives of forces and gaps by the averaged normals, times parts (p,)."""
    by_c, changes = np.concatenate([own.D, -own.M], axis=2), given.changes[place.slave]
    by_c, v = by_c * part[:, None, None], own.v * part[:, None, None]
    forces = np.swapaxes(by_c, 1, 2)[:, :, None, :, None] * np.swapaxes(changes, 1, 2)[:, None]
    gaps = v[:, :, None] @ given.turning[place.slave]  # (p, j, 1, 3)
    each = place.slave.reshape(-1, 1)  # a gap depends on the normal of its own node
    return (
        Blocks(place.nodes, place.slave, forces),
        Blocks(each, each, gaps.reshape(-1, 1, 1, 1, 3)),
    )
