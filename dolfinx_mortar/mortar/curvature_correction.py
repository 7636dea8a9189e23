# SPDX-License-Identifier: MIT
"""Smooth surfaces over the facets of two sides (theory.md, Curved sides): heights and offsets.

`fixed` are components (local nodes, d) with Dirichlet data, `sides` smooth surfaces at X, `which`
(q,) facets and `xi` (q, d-1) reference coordinates of points, `segments` those at X + u; feature
angles are in degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from dolfinx.common import timed
from dolfinx.fem import Function
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, Ints, flat
from dolfinx_mortar.geometry.curvature import (
    NodeNormals,
    arcs_of_chords,
    common_sagittas,
    curvature_slopes,
    curvatures,
    curved_sagittas,
    edge_sagittas,
    edges,
    end_angles,
    height_table,
    heights,
    heights_of_arcs,
    one_ring_sums,
    own_curvatures,
    sagitta_tensors,
)
from dolfinx_mortar.geometry.facets import Facets, facet_normals, points_of, surface_gradients, unit
from dolfinx_mortar.geometry.moments import height
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.mirrors import judge_supports, ring_sums
from dolfinx_mortar.mortar.pairing import Pairing, receive, received_facets
from dolfinx_mortar.mortar.surface import (
    Surface,
    coordinates,
    facets_at,
    nodal_means,
    sum_at_nodes,
    thickness_stretches,
)

PROJECTIONS = 2
"""Number of projections of edges on the tangent plane in space.

On a cylinder with uneven triangles, a tenth of its radius long, the errors of normals (rms) are
4e-3 without projection, 3e-4 with one, 1e-4 with two and three.
"""
JUMP = 3.0
"""Least ratio of a jump of curvature at a node in the plane to the changes at its neighbours:
infinite between parts of constant curvature, at most 2.7 on ellipses with axes 1 : 1.2 to 4 and 6
to 96 uneven facets a quarter."""

NodeShape: TypeAlias = NodeNormals | Floats
"""A smooth surface at its nodes: normals, or curvatures (n, d, d) of curved facets."""


def smooth_normals(
    surface: Surface, x: Floats, fixed: Bools, feature_angle: float, mirrors: Bools | None = None
) -> NodeNormals:
    """Normals of the smooth surface at the nodes, at x (n, d); collective.

    n = 0 where a facet's normal has no positive component along it. Mirror images complete facets
    at planes of symmetry. In space the deviatoric curvature projects edges. `fixed` is (n, d).
    """
    facets = facets_at(surface, x)
    if mirrors is None:
        mirrors, _ = judge_supports(surface, fixed, feature_angle)
    normals = _classify(surface, facets, one_ring_sums(facets), mirrors, feature_angle)
    for _ in range(PROJECTIONS if x.shape[1] > 2 else 0):
        K = _deviators(surface, facets, normals)[surface.facets]
        parts = one_ring_sums(facets, normals.n[surface.facets], K)
        normals = _classify(surface, facets, parts, mirrors, feature_angle)
    if x.shape[1] == 2:
        normals = replace(normals, jumps=_find_jumps(surface, facets, normals))
    return normals


def _find_jumps(surface: Surface, facets: Facets, normals: NodeNormals) -> Bools:
    ends = surface.facets[:, :2]
    angles, length = end_angles(facets, normals.n[ends])
    halves = np.repeat(length[:, None] / 2, 2, axis=1)
    total = _at_ends(surface, np.stack([angles, halves], axis=2))
    curvature = total[:, 0] / np.maximum(total[:, 1], TINY)
    known = normals.regular[ends].all(axis=1)
    change = np.where(known, np.diff(curvature[ends], axis=1)[:, 0], 0.0)
    both = np.stack([change, np.abs(change), known], axis=1)[:, None].repeat(2, axis=1)
    across, around, count = _at_ends(surface, both).T
    beyond = around[ends[:, ::-1]] - np.abs(change)[:, None]  # along the facet, at its other end
    size = np.abs(across)
    largest = size[ends] > size[ends[:, ::-1]]  # a jump changes both ends of short facets
    sure = (count[ends[:, ::-1]] == 2.0) & largest
    others, neighbours = _at_ends(surface, np.stack([beyond, sure], axis=2)).T
    above_round_off = size * total[:, 1] > HALF_OF_DIGITS
    return (size > JUMP * others) & (neighbours == 2.0) & above_round_off


def _at_ends(surface: Surface, values: Floats) -> Floats:
    m, k = surface.facets.shape
    return sum_at_nodes(surface, np.concatenate([values, np.zeros((m, k - 2, values.shape[2]))], 1))


def _deviators(surface: Surface, facets: Facets, normals: NodeNormals) -> Floats:
    """Deviatoric curvatures (n, d, d), means over regular facets; collective."""
    K = curvatures(facets, edge_sagittas(facets, normals, surface.facets))
    known = np.asarray(normals.regular[surface.facets].all(axis=1))
    n = facet_normals(facets)
    tangential = np.eye(3) - n[:, :, None] * n[:, None, :]
    K -= 0.5 * np.trace(K, axis1=1, axis2=2)[:, None, None] * tangential
    K *= known[:, None, None]
    mean = nodal_means(surface, np.column_stack([K.reshape(-1, 9), known]))
    return (mean[:, :-1] / np.maximum(mean[:, -1:], TINY)).reshape(-1, 3, 3)


def _classify(
    surface: Surface,
    facets: Facets,
    parts: tuple[Floats, Floats],
    mirrors: Bools,
    feature_angle: float,
) -> NodeNormals:
    """Normals of one-ring sums, open and edge nodes; collective."""
    (n, gap, limit), d = ring_sums(surface, parts), mirrors.shape[1]
    is_open = np.linalg.norm(gap, axis=1) > limit
    limits = np.cos(np.radians(feature_angle / 2)), HALF_OF_DIGITS  # cosines
    completed = straightened = is_open & mirrors.any(axis=1)
    if d > 2:  # one mirror closes a one-ring between its ends; in 2D any
        off_plane = np.linalg.norm(np.where(mirrors, gap, 0.0), axis=1) > limit
        completed = straightened & ((mirrors.sum(axis=1) > 1) | ~off_plane)
    straight = unit(np.where(mirrors, 0.0, n))
    n = np.where(straightened[:, None], straight, n)  # also where a rim meets the plane
    along = np.einsum("mki,mi->mk", n[surface.facets], facet_normals(facets))
    beyond = np.stack([along < least for least in limits], axis=2)
    counts = sum_at_nodes(surface, beyond)
    n = np.where(counts[:, 1:] > 0, 0.0, n)
    sharp = counts.max(axis=1) > 0
    return NodeNormals(n, is_open & ~completed, sharp)


class SmoothSide(NamedTuple):
    """Smooth surface over the facets of one side, at X."""

    facets: Facets  # (m,)
    normals: NodeNormals | None  # of all nodes; None over curved facets
    nodes: Ints  # (m, k) the facets' nodes
    sagitta: Floats  # (m, e) c_ab of `edge_sagittas`, or `curved_sagittas`
    edges: Ints  # (2,) numbers of owned nodes on an edge, and without a normal


SmoothSides: TypeAlias = tuple[SmoothSide, SmoothSide]


@timed("~Mortar: smooth surfaces")
def find_shape(
    surface: Surface, fixed: Bools, feature_angle: float, mirrors: Bools | None = None
) -> NodeShape:
    """Normals of a side at its nodes at X, or curvatures of curved facets; collective."""
    if surface.curved:
        K = own_curvatures(facets_at(surface, surface.X))
        return nodal_means(surface, flat(K)).reshape(-1, *K.shape[1:])
    return smooth_normals(surface, surface.X, fixed[surface.nodes], feature_angle, mirrors)


def find_smooth_sides(
    pairing: Pairing,
    fixed: Bools,
    feature_angle: float,
    shapes: Sequence[NodeShape] = (),
) -> SmoothSides:
    """Smooth surfaces of the slave and of the received master facets; collective."""
    slave, master = pairing.slave, pairing.master
    own, other = shapes or [find_shape(side, fixed, feature_angle) for side in (slave, master)]
    facets, count = received_facets(pairing, None), _count_edges(other, master.owned)
    if isinstance(other, NodeNormals):
        columns = [other.n, ~(other.regular | other.sharp), other.sharp]
        *n, one_sided, sharp = receive(pairing, np.column_stack(columns)).T
        other = NodeNormals(np.stack(n, axis=1), one_sided > 0.0, sharp > 0.0)
    else:
        other = receive(pairing, flat(other)).reshape(-1, *other.shape[1:])
    return (
        _over(facets_at(slave, slave.X), own, slave.facets, _count_edges(own, slave.owned)),
        _over(facets, other, pairing.master_facets, count),
    )


def find_smooth_side(surface: Surface, fixed: Bools, feature_angle: float) -> SmoothSide:
    """Smooth surface of a side alone; collective."""
    shape = find_shape(surface, fixed, feature_angle)
    count = _count_edges(shape, surface.owned)
    return _over(facets_at(surface, surface.X), shape, surface.facets, count)


def _over(facets: Facets, shape: NodeShape, nodes: Ints, count: Ints) -> SmoothSide:
    if isinstance(shape, NodeNormals):
        return SmoothSide(facets, shape, nodes, edge_sagittas(facets, shape, nodes), count)
    at_vertices = shape[nodes[:, facets.element.vertices]]
    sagitta = curved_sagittas(facets, own_curvatures(facets), at_vertices)
    return SmoothSide(facets, None, nodes, sagitta, count)


def _count_edges(normals: NodeShape, owned: int) -> Ints:
    if not isinstance(normals, NodeNormals):
        return np.zeros(2, dtype=np.int32)
    none = np.abs(normals.n[:owned]).max(axis=1, initial=0.0) == 0.0
    return np.array([normals.sharp[:owned].sum(), none.sum()], dtype=np.int32)


@dataclass(frozen=True)
class Curved:
    """Facets of one side at X + u, and their smooth surface."""

    facets: Facets  # (m,)
    sagitta: Floats  # (m, e) c_ab of the smooth surface
    arcs: Floats  # (m, 2) see `arcs_of_chords`
    which: Ints  # (m,) their numbers; one may occur in several pairs

    @cached_property
    def K(self) -> Floats:
        """Curvatures (m, d, d)."""
        return self._of_distinct(curvatures)

    @property
    def slopes(self) -> Floats:
        """Derivatives (m, k, d, d, d) of K by the nodes."""
        return self._of_distinct(curvature_slopes)

    def _of_distinct(self, find: Callable[[Facets, Floats], Floats]) -> Floats:
        _, first, again = np.unique(self.which, return_index=True, return_inverse=True)
        return find(self.facets[first], self.sagitta[first])[again]

    def shared(self, other: Curved) -> Floats:
        """Products c_ab (m, e) of the surface that both sides share if they are of first order."""
        if self.facets.element.degree > 1:
            return self.sagitta
        return common_sagittas(self.facets, self.sagitta, other.K)

    def heights(self, c: Floats, which: Ints, xi: Floats) -> Floats:
        """Heights (q,) of surfaces with c_ab (m, e) over points."""
        return heights_of_arcs(self.arcs[which], heights(self.facets, c, which, xi))


def _at(surface: Surface, facets: Facets, c: Floats, stretch: Floats | None, which: Ints) -> Curved:
    """Some facets of a side; of second order with the stretch (m, 1) of heights."""
    arcs, c, facets = np.tile([0.0, 1.0], (len(which), 1)), c[which], facets[which]
    if stretch is not None:
        c = c * stretch[which]
        if facets.x.shape[2] == 2 and not surface.curved:
            arcs = arcs_of_chords(facets, c)
    return Curved(facets, c, arcs, which)


def find_curved(
    pairing: Pairing,
    u: Function | None,
    sides: SmoothSides,
    pairs: Ints,
) -> tuple[Curved, Curved]:
    """Facets of both sides of pairs (p,), at X + u; collective.

    c_ab are those at X, of second order with the strain.
    """
    slave, (s, m) = pairing.slave, pairing.pairs[pairs].T
    own, other = _stretch(slave, u), None
    if u is not None and slave.element.degree > 1:
        of_nodes = thickness_stretches(pairing.master, u)[:, None]
        other = receive(pairing, of_nodes)[pairing.master_facets].mean(axis=1)
    facets = facets_at(slave, coordinates(slave, u))
    return (
        _at(slave, facets, sides[0].sagitta, own, s),
        _at(slave, received_facets(pairing, u), sides[1].sagitta, other, m),
    )


def _stretch(surface: Surface, u: Function | None) -> Floats | None:
    """Factors (m, 1) of heights of second order; collective."""
    if u is None or surface.element.degree == 1:
        return None
    return thickness_stretches(surface, u)[surface.facets].mean(axis=1, keepdims=True)


def _pairs_of(segments: Segments) -> tuple[Ints, Ints]:
    """Pairs (p,) with points, and the index (q,) of each point's pair."""
    pairs, of = np.unique(segments.pair, return_inverse=True)
    return pairs, of.astype(np.int32)


@timed("~Mortar: heights")
def point_heights(
    pairing: Pairing,
    segments: Segments,
    u: Function | None,
    sides: SmoothSides,
) -> Floats:
    """Sum of heights (q,), by which smooth surfaces are closer than facets; collective.

    First-order sides share one surface, see `common_sagittas`. Second-order heights are h (1 + e_n)
    with the strain e_n along the normal, as mid-side nodes move with the bodies.
    """
    pairs, of = _pairs_of(segments)
    a, b = find_curved(pairing, u, sides, pairs)
    h = a.heights(a.shared(b), of, segments.xi_s)
    return h + b.heights(b.shared(a), of, segments.xi_m)


def _side_at(surface: Surface, side: SmoothSide, u: Function | None) -> Curved:
    facets = facets_at(surface, coordinates(surface, u))
    every = np.arange(len(facets.x), dtype=np.int32)
    return _at(surface, facets, side.sagitta, _stretch(surface, u), every)


def side_heights(
    surface: Surface, side: SmoothSide, u: Function | None, which: Ints, xi: Floats
) -> Floats:
    """Heights (q,) of a second-order side at X + u; collective."""
    at = _side_at(surface, side, u)
    return at.heights(at.sagitta, which, xi)


def side_slopes(surface: Surface, side: SmoothSide, u: Function, which: Ints, xi: Floats) -> Floats:
    """Derivatives (q, k, d) of `side_heights`, at constant strain; collective."""
    at = _side_at(surface, side, u)
    slopes = np.zeros((len(which), *at.facets.x.shape[1:]))
    if at.arcs[:, 0].any():
        table = height_table(surface.element, at.sagitta.shape[1])
        Q = np.asarray(np.tensordot(at.sagitta, table, 1), dtype=np.float64)
        N = surface.element.shape_functions(xi)[:, None]
        e = edges(at.facets)[which, 0]
        by_length = height(N, Q[which], at.arcs[which])[2] / (e**2).sum(axis=1, keepdims=True)
        slopes[:, 1], slopes[:, 0] = by_length * e, -by_length * e
    return slopes


def missed_heights(
    pairing: Pairing,
    segments: Segments,
    u: Function | None,
    sides: SmoothSides,
) -> Floats:
    """Fourth-order error (q,) of heights of degree 1 over round surfaces; collective.

    Over facets of a sphere |x|^2 = R^2 - 2 R h, R - |x| = h + h^2 / (2 R).
    """
    pairs, of = _pairs_of(segments)
    a, b = find_curved(pairing, u, sides, pairs)
    return _missed(a, b, of, segments.xi_s) + _missed(b, a, of, segments.xi_m)


def _missed(side: Curved, other: Curved, of: Ints, xi: Floats) -> Floats:
    e, n = edges(side.facets), facet_normals(other.facets)[:, None]
    seen = e - (e * n).sum(axis=2, keepdims=True) * n
    square = (e**2).sum(axis=2)
    common = side.shared(other)
    longer = square / np.maximum((seen**2).sum(axis=2), TINY)
    right = side.sagitta / 2 + (common - side.sagitta / 2) * longer
    h, found = (heights(side.facets, c, of, xi) for c in (right, common))
    along = right / np.maximum(square, TINY)
    least, k = along.min(axis=1), along.max(axis=1)
    k = np.where(-least > k, least, k)
    return h + k[of] * h**2 / 2 - found


def point_motions(segments: Segments, sides: SmoothSides) -> Callable[[slice], Floats]:
    """Return a function: part of the points -> A_l (q, k, d, d) of offset vectors.

    The offset r = x_s - x_m moves with the bodies. To first order u_s = u_m + sum_l A_l u_l, with
    g_l = grad N_l on the master,

        A_l u_l = u_l (g_l.r) - (r.n) g_l (n.u_l) + n (H_t g_l).u_l:

    the displacement at the foot of x_s on the tangent plane, the rotation -(grad u)^T n of the
    normal part of r, and the change H : E of the heights by the strain, H = 1/2 sum_{a<b} N_a N_b
    C_ab of both sides, H_t its tangential part. A rigid motion u = a + W x gives W r. All at X.
    """
    slave, master = sides
    assert slave.normals is not None and master.normals is not None, "of straight facets"
    C_s = sagitta_tensors(slave.facets, slave.normals, slave.nodes)
    C_m = sagitta_tensors(master.facets, master.normals, master.nodes)

    def at(part: slice) -> Floats:
        s, m = segments.slave[part], segments.master[part]
        xi_s, xi_m = segments.xi_s[part], segments.xi_m[part]
        H = heights(slave.facets, C_s, s, xi_s) + heights(master.facets, C_m, m, xi_m)
        r = points_of(slave.facets, s, xi_s) - points_of(master.facets, m, xi_m)
        g, n = surface_gradients(master.facets, m, xi_m)
        along, stretch = np.einsum("qi,qi->q", r, n), g @ H
        stretch -= (stretch @ n[:, :, None]) * n[:, None]
        stretch, carried = stretch[:, :, None], along[:, None, None, None] * g[..., None]
        A = n[:, None, :, None] * stretch - carried * n[:, None, None]
        return A + (g @ r[:, :, None])[..., None] * np.eye(n.shape[1])

    return at


def find_parting(
    pairing: Pairing,
    segments: Segments,
    u: Function | None,
    sides: SmoothSides,
) -> float:
    """Mean of |k_s + k_m| over that of max(|k_s|, |k_m|), k = tr K; collective.

    1 for a ball on a plane, c / R for a pin with clearance c, infinite for planes.
    """
    pairs, of = _pairs_of(segments)
    size = np.bincount(of, segments.weight, minlength=len(pairs))
    k_s, k_m = (
        np.trace(side.K, axis1=1, axis2=2) for side in find_curved(pairing, u, sides, pairs)
    )
    local = np.array([size @ np.abs(k_s + k_m), size @ np.maximum(np.abs(k_s), np.abs(k_m))])
    apart, curved = pairing.slave.V.mesh.comm.allreduce(local)
    return float(apart / curved) if curved > 0.0 else np.inf
