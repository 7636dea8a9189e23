# SPDX-License-Identifier: MIT
"""Smooth surfaces through the nodes of facets: normals, and heights h over the facets.

See theory.md, Curved sides, for h and c_ab. Sides in contact have the common curvature K = (K_s -
K_m) / 2, each for its own outward normal, with e_ab.K e_ab = c_ab: c_ab is the mean of both. On
second-order facets each side has its own, times the stretch along the normal.

Normals are those of Max (J. Graphics Tools 4, 1999), n_a ~ sum (e_1 x e_2) / (|e_1|^2 |e_2|^2) with
the edges of each facet at the node; in 2D the chords' normals over their lengths. Unless facets
surround the node, edges in space are first projected on the tangent plane, by half of |e|^2 times
the deviatoric curvature; in 2D facets at a jump of curvature have that of their other end.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dolfinx_mortar.common.arrays import EPS, TINY, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import (
    FacetElement,
    Facets,
    area_vectors,
    facet_normals,
    scaled_normals,
    unit,
)

STEP = EPS * EPS
"""Imaginary part of a coordinate; its square is below round-off (complex step: Squire and Trapp,
SIAM Review 40, 1998)."""


@dataclass(frozen=True)
class NodeNormals:
    """Normals of a smooth surface at nodes."""

    n: Floats  # (n, d) unit, or zero
    open: Bools  # (n,) not surrounded: the normal may be one-sided
    sharp: Bools  # (n,) on an edge: no normal
    jumps: Bools | None = None  # (n,) the curvature jumps: the normal is one-sided

    @property
    def regular(self) -> Bools:
        """Nodes (n,) inside a surface without edge or jump of curvature."""
        smooth = ~self.open & ~self.sharp
        return smooth if self.jumps is None else smooth & ~self.jumps


def one_ring_sums(
    facets: Facets, n: Floats | None = None, K: Floats | None = None
) -> tuple[Floats, Floats]:
    """Terms of each facet (m,) in the sums over the one-rings of its nodes.

    (m, k, d) for normals, and (m, k, c) with the sum zero where facets surround the node. With
    normals n (m, k, d) and curvatures K (m, k, d, d) at the nodes, edges are projected.

    >>> from dolfinx_mortar.geometry.facets import LINE2
    >>> n, around = one_ring_sums(Facets(LINE2, np.array([[[2.0, 0.0], [0.0, 0.0]]])))
    >>> n.tolist(), around.tolist()
    ([[[0.0, 0.5], [0.0, 0.5]]], [[[-1.0], [1.0]]])
    """
    x = facets.x[:, facets.element.vertices]
    if x.shape[2] == 2:
        area = area_vectors(facets)
        chord = (area / np.maximum((area**2).sum(axis=1), TINY)[:, None])[:, None]
        ends = np.zeros((1, facets.element.nodes, 1))  # a mid-side node is no end
        ends[0, :2, 0] = -1.0, 1.0
        return np.repeat(chord, facets.element.nodes, axis=1), np.repeat(ends, len(x), axis=0)
    ahead, behind = (np.roll(x, turn, axis=1) - x for turn in (-1, 1))
    if n is not None and K is not None:
        corners = facets.element.vertices
        ahead, behind = (_projected(e, n[:, corners], K[:, corners]) for e in (ahead, behind))
    ahead, behind = (_divided(e, (e**2).sum(axis=2)) for e in (ahead, behind))
    normals = np.asarray(np.cross(ahead, behind), dtype=np.float64)
    middles = facets.element.nodes - x.shape[1]  # mid-side nodes have the facet's normal
    flat = np.repeat(facet_normals(facets)[:, None], middles, axis=1)
    around = np.concatenate([ahead - behind, np.zeros_like(flat)], axis=1)
    return np.concatenate([normals, flat], axis=1), around


def end_angles(facets: Facets, n: Floats) -> tuple[Floats, Floats]:
    """Sines (m, 2) of the angles between lines and tangents at their ends, and lengths (m,)."""
    chord = edges(facets)[:, 0]
    length = np.linalg.norm(chord, axis=1)
    ends = np.array([-1.0, 1.0])[:, None]
    along = chord[:, None] / np.maximum(length, TINY)[:, None, None]
    return (ends * n * along).sum(axis=2), length


def _projected(e: Floats, n: Floats, K: Floats) -> Floats:
    """Edges e + 1/2 |e|^2 (t.K t) n (m, k, d) on the tangent plane, t tangential."""
    t = unit(e - np.einsum("mki,mki->mk", e, n)[..., None] * n)
    below = 0.5 * (e**2).sum(axis=2) * np.einsum("mki,mkij,mkj->mk", t, K, t)
    return e + below[..., None] * n


def normal_changes(facets: Facets, normals: NodeNormals, nodes: Ints) -> Floats:
    """Changes of normals m_ab (m, e, d), n_b - n_a unless the normal of an end is one-sided.

    If only b is regular, m_ab = 2 n_b, exact on spheres and cylinders; if none is, n_b - n_a, or
    zero at edges. Nodes are (m, k).
    """
    a, b = node_pairs(facets.element.first)
    at_a, at_b = (normals.n[nodes[:, end]] for end in (a, b))
    regular, sharp = normals.regular[nodes][..., None], normals.sharp[nodes][..., None]
    result = at_b - at_a
    result = np.where(regular[:, a] & ~regular[:, b], -2.0 * at_a, result)
    result = np.where(regular[:, b] & ~regular[:, a], 2.0 * at_b, result)
    neither = ~regular[:, a] & ~regular[:, b] & (sharp[:, a] | sharp[:, b])
    return np.where(neither, 0.0, result)


def edge_sagittas(facets: Facets, normals: NodeNormals, nodes: Ints) -> Floats:
    """Products c_ab = m_ab.(x_b - x_a) (m, e) for the pairs of nodes, see `normal_changes`."""
    return np.einsum("mei,mei->me", normal_changes(facets, normals, nodes), edges(facets))


def own_curvatures(facets: Facets) -> Floats:
    """Curvatures K (m, d, d), symmetric, fitted to the nodes of second-order facets.

    Over the tangent plane at the centre a surface of constant curvature has the height w = const +
    g.y - y.K y / 2 - |K y|^2 y.K y / 8. The larger curvature k is added as k n n^T: K is I / R on
    spheres and (I - a a^T) / R on cylinders with the axis a.

    >>> from dolfinx_mortar.geometry.facets import LINE3
    >>> facet = Facets(LINE3, np.array([[[0.6, 0.8], [-0.6, 0.8], [0.0, 1.0]]]))
    >>> own_curvatures(facet).round(1).tolist()  # of a circle
    [[[1.0, 0.0], [0.0, 1.0]]]
    """
    element, (m, k, d) = facets.element, facets.x.shape
    n = unit(scaled_normals(facets, element.centre)[:, 0])
    to_y = np.linalg.pinv(np.swapaxes(facets.x, 1, 2) @ element.functions(element.centre)[1][0].T)
    x = facets.x - facets.x.mean(axis=1, keepdims=True)
    y, w = x @ np.swapaxes(to_y, 1, 2), np.einsum("mki,mi->mk", x, n)
    i, j = np.triu_indices(d - 1)
    squares = y[:, :, i] * y[:, :, j] * np.where(i == j, -0.5, -1.0)
    A = np.concatenate([np.ones((m, k, 1)), y, squares], axis=2)
    A_T, K = np.swapaxes(A, 1, 2), np.zeros((m, d - 1, d - 1))
    for _ in range(3):
        K_y = y @ K
        higher = ((K_y @ to_y) ** 2).sum(axis=2) * (K_y * y).sum(axis=2) / 8
        fitted = np.linalg.solve(A_T @ A, A_T @ (w + higher)[:, :, None])[:, d:, 0]
        K[:, i, j] = K[:, j, i] = fitted
    tangential = np.swapaxes(to_y, 1, 2) @ K @ to_y
    both = np.linalg.eigvalsh(tangential)
    larger = np.where(-both[:, 0] > both[:, -1], both[:, 0], both[:, -1])
    return tangential + larger[:, None, None] * n[:, :, None] * n[:, None]


def curved_sagittas(facets: Facets, K: Floats, at_vertices: Floats) -> Floats:
    """Products c_ab = e_ab.(K + 2/3 dK) e_ab (m, e) for all pairs of nodes of curved facets.

    Right to third order, with the change dK of the curvature halfway, times max(1 - 2 max |dK| /
    |K|, 0), as a jump of the curvature is no change along the facet. K (m, d, d) is that of facets,
    at_vertices (m, v, d, d) has nodal means.

    >>> from dolfinx_mortar.geometry.facets import LINE3
    >>> facet = Facets(LINE3, np.array([[[0.1, 0.0], [-0.1, 0.0], [0.0, 0.001]]]))
    >>> K = own_curvatures(facet)
    >>> curved_sagittas(facet, K, K[:, None]).round(4).tolist()  # R = 5: 0.04 / R, 0.01 / R
    [[0.008, 0.002, 0.002]]
    """
    element = facets.element
    (a, b), e = node_pairs(element), edges(facets, element)
    change = at_vertices - K[:, None]
    size, largest = (np.linalg.norm(part, axis=(-2, -1)) for part in (K, change))
    share = np.maximum(1.0 - 2.0 * largest.max(axis=1) / np.maximum(size, TINY), 0.0)
    halfway = element.first.shape_functions((element.points[a] + element.points[b]) / 2)
    along = np.einsum("mvij,mei,mej->mve", change, e, e)
    own = np.einsum("mij,mei,mej->me", K, e, e)
    return own + 2.0 / 3.0 * share[:, None] * np.einsum("ev,mve->me", halfway, along)


def sagitta_tensors(facets: Facets, normals: NodeNormals, nodes: Ints) -> Floats:
    """Tensors C_ab (m, e, d, d), the symmetric part of m_ab (x_b - x_a)^T, with trace c_ab.

    A strain E of the surface changes c_ab by C_ab : E. m_ab is tangential.
    """
    change, n = normal_changes(facets, normals, nodes), facet_normals(facets)[:, None]
    change -= (change * n).sum(axis=2, keepdims=True) * n
    product = change[..., :, None] * edges(facets)[..., None, :]
    return (product + np.swapaxes(product, 2, 3)) / 2


def curvatures(facets: Facets, sagitta: Floats) -> Floats:
    """Curvatures K (m, d, d), tangential and symmetric: e_ab.K e_ab = c_ab, least squares.

    >>> from dolfinx_mortar.geometry.facets import LINE2
    >>> facet = Facets(LINE2, np.array([[[2.0, 0.0], [0.0, 0.0]]]))
    >>> (curvatures(facet, np.array([[1.0]])).round(12) + 0.0).tolist()  # without -0.0
    [[[0.25, 0.0], [0.0, 0.0]]]
    """
    e = edges(facets, height_element(facets.element, sagitta))
    if e.shape[2] == 2:
        t = _divided(e[:, 0], (e[:, 0] ** 2).sum(axis=1))
        return sagitta[:, :1, None] * t[:, :, None] * t[:, None]
    B = _frame(facets)
    p, q = np.moveaxis(e @ B, 2, 0)
    A = np.stack([p * p, 2.0 * p * q, q * q], axis=2)
    A = _divided(A, p * p + q * q) * (e**2).sum(axis=2)[..., None]  # on spheres c_ab is |e|^2 / R
    A_T = A.swapaxes(1, 2)
    N = A_T @ A
    size = EPS * np.trace(N, axis1=1, axis2=2) + TINY  # needles: regularised across
    N += size[:, None, None] * np.eye(3)
    k = np.linalg.solve(N, A_T @ sagitta[:, :, None])[:, [0, 1, 1, 2], 0]
    return B @ k.reshape(-1, 2, 2) @ B.swapaxes(1, 2)


def curvature_slopes(facets: Facets, sagitta: Floats) -> Floats:
    """Derivatives (m, k, d, d, d) of `curvatures` by the nodes, by complex steps."""
    m, k, d = facets.x.shape
    x = facets.x[:, None] + 1j * STEP * np.eye(k * d).reshape(-1, k, d)
    moved = Facets(facets.element, x.reshape(m * k * d, k, d))
    found = curvatures(moved, sagitta.repeat(k * d, axis=0))
    return np.asarray(found.imag / STEP).reshape(m, k, d, d, d)


def _divided(v: Floats, square: Floats) -> Floats:
    """Quotient, zero where `square` is; also for complex numbers."""
    return v / np.where(square.real > 0.0, square, np.inf)[..., None]


def _frame(facets: Facets) -> Floats:
    n, first = unit(area_vectors(facets)), facets.x[:, 1] - facets.x[:, 0]
    second = unit(np.asarray(np.cross(n, first)))
    return np.stack([np.cross(second, n), second], axis=2)


def height_table(element: FacetElement, e: int) -> Floats:
    """Coefficients N_a N_b / 2 (e, k, k), symmetric, as products of N, for e c_ab."""
    of = height_element(element, np.empty((0, e)))
    V = np.eye(element.nodes) if of is element else of.shape_functions(element.points).T
    a, b = node_pairs(of)
    products = V[a][:, :, None] * V[b][:, None]
    return (products + np.swapaxes(products, 1, 2)) / 4


def common_sagittas(facets: Facets, sagitta: Floats, K_other: Floats) -> Floats:
    """Products c_ab (m, e) of the surface that two sides share where they touch.

    From those of one side, and curvatures (m, d, d) of the other for its own outward normal.
    """
    e = edges(facets)
    return 0.5 * (sagitta - np.einsum("mei,mij,mej->me", e, K_other, e))


def heights(facets: Facets, sagitta: Floats, which: Ints, xi: Floats) -> Floats:
    """Heights (q,) of the smooth surface over points of facets, along their normals.

    Args:
        sagitta: c_ab (p, e), or tensors C_ab (p, e, d, d).
        which: (q,) row of sagitta for each point.
        xi: (q, d-1) reference coordinates.
    """
    element = height_element(facets.element, sagitta)
    a, b = node_pairs(element)
    N = element.shape_functions(xi)
    return 0.5 * np.einsum("qe,qe...->q...", N[:, a] * N[:, b], sagitta[which])


def arcs_of_chords(facets: Facets, sagitta: Floats) -> Floats:
    """Curvature k = c_ab / L^2 and cos^2 b (m, 2) of the arcs over lines with c_ab (m, 1).

    b is the angle between chord and end tangent, sin b = k L / 2.
    """
    a, b = facets.element.vertices
    chord = np.linalg.norm(facets.x[:, b] - facets.x[:, a], axis=1)
    k = sagitta[:, 0] / np.maximum(chord**2, TINY)
    return np.stack([k, np.maximum(1.0 - (k * chord / 2) ** 2, TINY)], axis=1)


def heights_of_arcs(arcs: Floats, h: Floats) -> Floats:
    """Heights (q,) over chords, exact on circles: h^2 k + 2 h cos b = 2 h_0.

    h_0 (q,) of `heights` is too inexact for pressures in second order. For arcs (q, 2) see
    `arcs_of_chords`; k = 0 gives h_0.

    >>> from dolfinx_mortar.geometry.facets import LINE3
    >>> facet = Facets(LINE3, np.array([[[0.6, 0.8], [-0.6, 0.8], [0.0, 0.8]]]))
    >>> middle, c_ab = np.zeros(1, dtype=np.int32), np.array([[1.44]])
    >>> h = heights(facet, c_ab, middle, np.zeros((1, 1)))
    >>> heights_of_arcs(arcs_of_chords(facet, c_ab)[middle], h).round(12).tolist()
    [0.2]
    """
    k, square = arcs.T
    return 2.0 * h / (np.sqrt(square) + np.sqrt(square + 2.0 * k * h))


def edges(facets: Facets, element: FacetElement | None = None) -> Floats:
    """Edges x_b - x_a (m, e, d) for the pairs of vertices, or of nodes of `element`."""
    a, b = node_pairs(element or facets.element.first)
    return facets.x[:, b] - facets.x[:, a]


def height_element(element: FacetElement, sagitta: Floats) -> FacetElement:
    """The type with the functions N_a of heights."""
    few = sagitta.shape[1] == len(node_pairs(element.first)[0])
    return element.first if few else element


def node_pairs(element: FacetElement) -> tuple[list[int], list[int]]:
    """First and second nodes of all pairs of nodes of a facet.

    >>> from dolfinx_mortar.geometry.facets import TRI3
    >>> node_pairs(TRI3)
    ([0, 0, 1], [1, 2, 2])
    """
    pairs = list(combinations(range(element.nodes), 2))
    return [a for a, _ in pairs], [b for _, b in pairs]
