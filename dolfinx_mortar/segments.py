# SPDX-License-Identifier: MIT
r"""Which part of a slave facet lies over which master facet, and quadrature points there.

Everything that depends on the space dimension is in this file: normals of facets, the direction
of projection, clipping and splitting. Facets are plain arrays of node coordinates; dofs, ranks and
matrices are unknown here.

In 2D a slave facet is x_s(xi) = N_1(xi) x_1 + N_2(xi) x_2 with xi in [-1, 1], and it is projected
along the interpolated averaged nodal normals n(xi) = N_1 n_1 + N_2 n_2 (not normalised). The
point of the master line that belongs to xi solves (x_s(xi) - x_m) x n(xi) = 0.
"""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

FACING = 0.2
"""A master facet faces a slave facet if n_s . n_m < -FACING at all nodes of the slave facet."""
TURN = 0.03
"""Rotation (radians) after the search for which the margin of the candidate pairs provides."""
FACING_MARGIN = 0.3
"""Change of n_s . n_m after the search for which the candidate pairs provide."""
SHORTEST = 1e-12
"""Segments that are shorter than this part of half a slave facet are dropped."""
_STEEPEST = 1e30  # tangent of the opening angle of a cone that is a half space or wider
_BLOCK = 16  # balls that the broad phase rejects with one test

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, eq=False)
class Segments:
    """Quadrature points of all segments, ordered by slave facet.

    The weights contain the Jacobian of the slave facet: over the points of one slave facet they
    add up to the length (area) of its part that is covered by the master side.
    """

    pair: Ints  # (q,) index into the candidate pairs
    slave: Ints  # (q,) slave facet, ascending
    master: Ints  # (q,) master facet
    xi_s: Floats  # (q, d-1) reference coordinates on the slave facet
    xi_m: Floats  # (q, d-1) reference coordinates of the projection on the master facet
    weight: Floats  # (q,) quadrature weight times Jacobian, positive
    facet_weights: Floats  # (ms, k) integral of N_j over each whole slave facet, covered or not


@dataclass(frozen=True, eq=False)
class Cones:
    """Regions that the projections of slave facets, or of groups of them, cannot leave.

    A cone is the set of points p with |lateral part of p - c| <= radius + |axial part| * slope,
    lateral and axial with respect to its axis, on both sides of c.
    """

    centre: Floats  # (m, d)
    axis: Floats  # (m, d) unit vectors
    radius: Floats  # (m,)
    slope: Floats  # (m,)


def facet_normals(x: Floats) -> Floats:
    """Return the outward unit normals (m, d) of facets with the node coordinates x (m, k, d).

    In 2D the normal of the facet from x_1 to x_2 is (t_y, -t_x)/|t| with t = x_2 - x_1.

    Example:
        >>> facet_normals(np.array([[[7.0, 7.0], [4.0, 3.0]]])) * 5
        array([[-4.,  3.]])
    """
    t = x[:, 1] - x[:, 0]
    n = np.stack([t[:, 1], -t[:, 0]], axis=1)
    return n / np.maximum(np.linalg.norm(n, axis=1), np.finfo(float).tiny)[:, None]


def facet_sizes(x: Floats) -> Floats:
    """Return the diameter (m,) of facets with the node coordinates x (m, k, d)."""
    return 2 * bounding_balls(x)[1]


def shape_functions(xi: Floats) -> Floats:
    """Return the values (q, k) of the nodal shape functions at reference points xi (q, d-1).

    Example:
        >>> shape_functions(np.array([[-1.0], [0.5]]))
        array([[1.  , 0.  ],
               [0.25, 0.75]])
    """
    return np.concatenate([(1 - xi) / 2, (1 + xi) / 2], axis=1)


def bounding_balls(x: Floats) -> tuple[Floats, Floats]:
    """Return centre (m, d) and radius (m,) of balls around facets x (m, k, d)."""
    centre = x.mean(axis=1)
    return centre, np.sqrt(((x - centre[:, None]) ** 2).sum(axis=2).max(axis=1, initial=0.0))


def create_cones(x_s: Floats, n_s: Floats, margin: Floats, turn: float = 0.0) -> Cones:
    """Bound the projections of slave facets, plus a margin.

    Args:
        x_s: Node coordinates (m, k, d); a group of facets is a facet with many nodes.
        n_s: Unit nodal normals (m, k, d).
        margin: Lateral margin (m,).
        turn: Tangent of the rotation for which to provide.
    """
    centre, radius = bounding_balls(x_s)
    axis = n_s.mean(axis=1)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), np.finfo(float).tiny)[:, None]
    cosine = np.clip((n_s * axis[:, None]).sum(axis=2).min(axis=1, initial=1.0), -1, 1)
    slope = np.full(len(radius), _STEEPEST)
    narrow = cosine > 0.1
    slope[narrow] = np.sqrt(1 - cosine[narrow] ** 2) / cosine[narrow] + turn
    # Normals start anywhere in the ball, hence the slope acts on one radius more; the last
    # factor makes the cone contain its own facet in spite of round-off.
    return Cones(centre, axis, (radius * (1 + slope) + margin) * (1 + 1e-10), slope)


@numba.njit(cache=True)
def _meets(c, axis, radius, slope, p, rho):  # type: ignore[no-untyped-def]
    """Tell whether the cone at c can meet the ball at p."""
    axial = 0.0
    square = 0.0
    for i in range(c.size):
        axial += (p[i] - c[i]) * axis[i]
        square += (p[i] - c[i]) ** 2
    lateral = np.sqrt(max(square - axial * axial, 0.0))
    return lateral <= radius + rho + (abs(axial) + rho) * slope


@numba.njit(cache=True)
def _meeting(centre, axis, radius, slope, ball, rho, block, block_rho, size):  # type: ignore[no-untyped-def]
    """Return all pairs (cone, ball) that can meet; balls come in blocks of the given size."""
    pairs = np.empty((4 * (len(radius) + len(rho)) + 64, 2), dtype=np.int32)
    p = 0
    for s in range(len(radius)):
        c, a, r, t = centre[s], axis[s], radius[s], slope[s]
        for b in range(len(block)):
            if not _meets(c, a, r, t, block[b], block_rho[b]):
                continue
            for m in range(b * size, min((b + 1) * size, len(rho))):
                if _meets(c, a, r, t, ball[m], rho[m]):
                    if p == len(pairs):
                        longer = np.empty((2 * p, 2), dtype=np.int32)
                        longer[:p] = pairs
                        pairs = longer
                    pairs[p, 0] = s
                    pairs[p, 1] = m
                    p += 1
    return pairs[:p]


def find_meeting(cones: Cones, centre: Floats, radius: Floats) -> Ints:
    """Return the pairs (p, 2) of cones and balls that can meet, ordered by cone, then ball."""
    if len(cones.radius) == 0 or len(radius) == 0:
        return np.empty((0, 2), dtype=np.int32)
    order = cKDTree(centre, leafsize=_BLOCK).indices  # neighbours in space become neighbours
    centre, radius = np.ascontiguousarray(centre[order]), radius[order]
    first = np.arange(0, len(radius), _BLOCK)
    count = np.diff(np.append(first, len(radius)))
    block = np.add.reduceat(centre, first) / count[:, None]
    reach = np.linalg.norm(centre - np.repeat(block, count, axis=0), axis=1) + radius
    block_radius = np.maximum.reduceat(reach, first) * (1 + 1e-10)
    pairs: Ints = _meeting(
        cones.centre, cones.axis, cones.radius, cones.slope, centre, radius, block, block_radius,
        _BLOCK,
    )  # fmt: skip
    pairs[:, 1] = order[pairs[:, 1]]
    ordered: Ints = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return ordered


def are_facing(n_s: Floats, n_m: Floats, slack: float = 0.0) -> npt.NDArray[np.bool_]:
    """Tell (p,) whether facets with nodal normals n_s (p, k, d) face those with n_m (p, d)."""
    return np.einsum("pki,pi->pk", n_s, n_m).max(axis=1, initial=-1.0) < slack - FACING


def find_candidates(
    x_s: Floats, n_s: Floats, x_m: Floats, margin: Floats, *, moving: bool = True
) -> Ints:
    """Find the pairs of facets that can share a segment, at any distance from each other.

    Args:
        x_s: Node coordinates (ms, k, d) of the slave facets.
        n_s: Unit averaged normals (ms, k, d) at these nodes.
        x_m: Node coordinates (mm, k, d) of the master facets.
        margin: Lateral margin (ms,) for which to provide.
        moving: Provide for the rotations TURN and FACING_MARGIN as well.

    Returns:
        Pairs (p, 2) of slave and master facet, ordered by slave, then master. Without margins they
        are still a superset of the pairs that have segments.
    """
    cones = create_cones(x_s, n_s, margin, TURN if moving else 0.0)
    pairs = find_meeting(cones, *bounding_balls(x_m))
    n_m = facet_normals(x_m)
    slack = FACING_MARGIN if moving else 0.0
    return pairs[are_facing(n_s[pairs[:, 0]], n_m[pairs[:, 1]], slack)]


@numba.njit(cache=True)
def _moment(x, i, y, n):  # type: ignore[no-untyped-def]
    """Return (x_i - y) x n_i."""
    return (x[i, 0] - y[0]) * n[i, 1] - (x[i, 1] - y[1]) * n[i, 0]


@numba.njit(cache=True)
def _project_node(x, n, y):  # type: ignore[no-untyped-def]
    """Return xi in [-1, 1] of the slave facet whose normal meets y; beyond an end, that end.

    f(xi) = (x(xi) - y) x n(xi) falls along the facet as long as y is nearer than the point where
    the normals of a concave facet meet; there is no answer (nan) behind that point.
    """
    first, last = _moment(x, 0, y, n), _moment(x, 1, y, n)
    if first <= 0.0 or last >= 0.0:
        if first <= 0.0 and last >= 0.0:
            return np.nan
        return -1.0 if first <= 0.0 else 1.0
    h0, h1 = (x[1, 0] - x[0, 0]) / 2, (x[1, 1] - x[0, 1]) / 2
    d0, d1 = (n[1, 0] - n[0, 0]) / 2, (n[1, 1] - n[0, 1]) / 2
    # f = A + B xi + C xi^2 with f(-1) > 0 > f(1); the root in the form that does not cancel
    C = h0 * d1 - h1 * d0
    A, B = (first + last) / 2 - C, (last - first) / 2
    return min(max(2 * A / (np.sqrt(max(B * B - 4 * A * C, 0.0)) - B), -1.0), 1.0)


@numba.njit(cache=True)
def _distance(x, n, y, normal, xi):  # type: ignore[no-untyped-def]
    """Return the distance along n(xi) from the slave facet to the master line through y[0]."""
    height, slope, square = 0.0, 0.0, 0.0
    for i in range(2):
        p = (1 - xi) / 2 * (x[0, i] - y[0, i]) + (1 + xi) / 2 * (x[1, i] - y[0, i])
        m = (1 - xi) / 2 * n[0, i] + (1 + xi) / 2 * n[1, i]
        height += p * normal[i]
        slope += m * normal[i]
        square += m * m
    return abs(height / slope) * np.sqrt(square)


@numba.njit(cache=True)
def _nearest(x, n, x_m, n_m, master, low, high, a, b):  # type: ignore[no-untyped-def]
    """Return the candidate that covers [a, b] at the smallest distance, -1 if there is none."""
    best, least = -1, np.inf
    for c in range(len(master)):
        if low[c] <= a and high[c] >= b:
            m = master[c]
            distance = _distance(x, n, x_m[m], n_m[m], (a + b) / 2)
            if distance < least:
                best, least = c, distance
    return best


@numba.njit(cache=True)
def _insert(cuts, count, value):  # type: ignore[no-untyped-def]
    """Insert a value into the first `count` ascending ones."""
    while count > 0 and cuts[count - 1] > value:
        cuts[count] = cuts[count - 1]
        count -= 1
    cuts[count] = value


@numba.njit(cache=True)
def _clip(x_s, n_s, x_m, n_m, pairs):  # type: ignore[no-untyped-def]
    """Return the pair and the ends in xi of all segments; no part of a slave facet occurs twice."""
    p = len(pairs)
    which, ends = np.empty(2 * p, dtype=np.int32), np.empty((2 * p, 2))
    low, high, cuts = np.empty(p), np.empty(p), np.empty(2 * p)
    index, master = np.empty(p, dtype=np.int32), np.empty(p, dtype=np.int32)
    q = 0
    r = 0
    while r < p:
        s = pairs[r, 0]
        c = 0
        while r < p and pairs[r, 0] == s:
            y = x_m[pairs[r, 1]]
            # the two sides run against each other
            a, b = _project_node(x_s[s], n_s[s], y[1]), _project_node(x_s[s], n_s[s], y[0])
            if b - a > SHORTEST:
                low[c], high[c], index[c], master[c] = a, b, r, pairs[r, 1]
                _insert(cuts, 2 * c, a)
                _insert(cuts, 2 * c + 1, b)
                c += 1
            r += 1
        start = q
        for i in range(2 * c - 1):
            a, b = cuts[i], cuts[i + 1]
            if b - a <= SHORTEST:
                continue
            best = _nearest(x_s[s], n_s[s], x_m, n_m, master[:c], low, high, a, b)
            if best < 0:
                continue
            if q > start and which[q - 1] == index[best] and ends[q - 1, 1] == a:
                ends[q - 1, 1] = b
                continue
            which[q], ends[q, 0], ends[q, 1] = index[best], a, b
            q += 1
    return which[:q], ends[:q]


def _opposite(x_s: Floats, n_s: Floats, x_m: Floats, xi: Floats) -> Floats:
    """Return xi_m (s, q) on the master lines x_m (s, 2, 2) met by the normals at xi (s, q)."""

    def at(v: Floats, xi: Floats) -> Floats:
        return (1 - xi[..., None]) / 2 * v[:, None, 0] + (1 + xi[..., None]) / 2 * v[:, None, 1]

    n = at(n_s, xi)
    p = at(x_s - x_m.mean(axis=1, keepdims=True), xi)
    h = (x_m[:, 1] - x_m[:, 0])[:, None] / 2
    numerator = p[..., 0] * n[..., 1] - p[..., 1] * n[..., 0]
    return numerator / (h[..., 0] * n[..., 1] - h[..., 1] * n[..., 0])


def create_segments(x_s: Floats, n_s: Floats, x_m: Floats, pairs: Ints) -> Segments:
    """Project, clip and place three Gauss points on every segment.

    On flat facets the points integrate Phi_j N_l and Phi_j N_l (quadratic) exactly. Where several
    master facets lie behind each other, the one at the smallest distance covers the slave.

    Args:
        x_s: Node coordinates (ms, 2, 2) of the slave facets.
        n_s: Averaged normals (ms, 2, 2) at these nodes.
        x_m: Node coordinates (mm, 2, 2) of the master facets.
        pairs: Candidates (p, 2), ordered by slave facet.
    """
    assert x_s.shape[1:] == x_m.shape[1:] == (2, 2), "only two-node facets in 2D so far"
    n_m = facet_normals(x_m)
    facing = np.flatnonzero(are_facing(n_s[pairs[:, 0]], n_m[pairs[:, 1]]))
    which, ends = _clip(x_s, n_s, x_m, n_m, pairs[facing])
    pair = facing[which].astype(np.int32)
    slave, master = pairs[pair].T
    half = (ends[:, 1] - ends[:, 0]) / 2
    xi = (ends[:, 0] + ends[:, 1])[:, None] / 2 + half[:, None] * _POINTS
    length = np.linalg.norm(x_s[:, 1] - x_s[:, 0], axis=1)
    weight = (half * length[slave] / 2)[:, None] * _WEIGHTS
    xi_m = _opposite(x_s[slave], n_s[slave], x_m[master], xi)
    q = len(_POINTS)
    return Segments(
        pair=np.repeat(pair, q),
        slave=np.repeat(slave, q),
        master=np.repeat(master, q),
        xi_s=xi.reshape(-1, 1),
        xi_m=xi_m.reshape(-1, 1),
        weight=weight.ravel(),
        facet_weights=np.repeat(length[:, None] / 2, 2, axis=1),
    )
