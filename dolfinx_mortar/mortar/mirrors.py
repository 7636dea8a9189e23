# SPDX-License-Identifier: MIT
"""Which supports at the ends of a side are planes of symmetry (theory.md, Curved sides).

On smooth sides chords have (n_j + n_k).(x_k - x_j) = 0, so that the vertices x_k off the support
give the normal n_j. With the fixed component e and the normals n_f of these facets

    A = mean of n_f.e,     B = A - n_j.e:

A = B on a plane of symmetry, B = 0 on a flat side or a single facet.
"""

from dataclasses import replace

import numpy as np

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, QUARTER_OF_DIGITS, SAME, Bools, Floats
from dolfinx_mortar.geometry.curvature import one_ring_sums
from dolfinx_mortar.geometry.facets import facet_normals, unit
from dolfinx_mortar.mortar.surface import Surface, facets_at, sum_at_nodes


def judge_supports(surface: Surface, fixed: Bools, feature_angle: float) -> tuple[Bools, Floats]:
    """Components (n, d) across planes of symmetry, and n_j.e (n, d), at X; collective.

    Where A and B have the same sign and differ by a factor of at most two, or A is less than the
    scatter of n_f.e; not where all components are fixed, nor inside a side. Mid-side nodes have
    means of the vertices. Edges of more than `feature_angle` degrees have no curvature.
    """
    n, gap, limit = ring_sums(surface, one_ring_sums(facets_at(surface, surface.X)))
    closed = np.linalg.norm(gap, axis=1) <= limit
    tilt, mirrors = np.zeros(fixed.shape), fixed & ~fixed.all(axis=1, keepdims=True)
    for i in range(fixed.shape[1]):
        some = fixed[surface.facets, i].any(axis=1)
        side = replace(surface, facets=surface.facets[some], entities=surface.entities[some])
        found, tilt[:, i] = _judge(side, n, closed, fixed[:, i], i, feature_angle)
        mirrors[:, i] &= found
    return mirrors, tilt


def _judge(
    side: Surface, n: Floats, closed: Bools, fixed: Bools, i: int, feature_angle: float
) -> tuple[Bools, Floats]:
    vertices = side.facets[:, side.element.vertices]
    held, n_f = fixed[vertices], facet_normals(facets_at(side, side.X))
    weights = np.where(closed[vertices], 1.0, QUARTER_OF_DIGITS)  # others only if alone
    cosines = np.einsum("mki,mi->mk", n[vertices], n_f)
    weights[held | (cosines < np.cos(np.radians(feature_angle / 2)))] = 0.0
    between = side.element.first.shape_functions(side.element.points)
    columns = np.stack([n_f[:, i], n_f[:, i] ** 2, np.ones(len(n_f))], axis=1)[:, None]
    sums = sum_at_nodes(side, columns.repeat(len(between), axis=1))
    means = np.ones((len(n), 4))
    means[:, 0] = sums[:, 0] / np.maximum(sums[:, 2], 1.0)
    means[:, 1], means[:, 2] = _by_chords(side, n, weights, fixed)[:, i], closed
    around = np.where(held[:, :, None], sums[vertices], 0.0).sum(axis=1, keepdims=True)
    columns = np.concatenate(
        [between @ means[vertices], around.repeat(len(between), axis=1)], axis=2
    )
    *own, count, mean, square, number = sum_at_nodes(side, columns).T
    A, tilt, inside = np.array(own) / np.maximum(count, 1.0)
    B = A - tilt
    spread = np.sqrt(np.maximum(square * number - mean**2, 0.0))
    upright = np.abs(mean) < np.maximum(spread, HALF_OF_DIGITS * number)
    curved = (A * B > 0.0) & (np.abs(A) <= 2.0 * np.abs(B)) & (np.abs(B) <= 2.0 * np.abs(A))
    return (inside == 0.0) & (upright | curved), tilt


def _by_chords(side: Surface, n: Floats, weights: Floats, which: Bools) -> Floats:
    """Normals (n, d) by chords at some nodes, else n; collective."""
    corners, d = side.element.vertices, n.shape[1]
    ends = side.facets[:, corners]
    x = side.X[ends]
    t = unit(x[:, None] - x[:, :, None])  # (m, v, v, d) from j to k
    products = weights[:, None, :, None, None] * t[..., None] * t[..., None, :]
    squares = products.sum(axis=2).reshape(*ends.shape, d * d)
    moments = np.einsum("mjkil,mkl->mji", products, n[ends])
    columns = np.zeros((*side.facets.shape, d * d + d))
    columns[:, corners] = np.concatenate([squares, moments], axis=2)
    square, moment = np.split(sum_at_nodes(side, columns)[which], [d * d], axis=1)
    square, result, n = square.reshape(-1, d, d), n.copy(), n[which]
    across = np.eye(d) - n[:, :, None] * n[:, None]
    right = across @ (moment[:, :, None] + square @ n[:, :, None])
    inverse = np.linalg.pinv(across @ square @ across, SAME, hermitian=True)
    change = -(inverse @ right)[:, :, 0]
    rest = np.sqrt(np.maximum(1.0 - (change**2).sum(axis=1, keepdims=True), 0.0))
    result[which] = change + rest * n
    return result


def ring_sums(surface: Surface, parts: tuple[Floats, Floats]) -> tuple[Floats, Floats, Floats]:
    """Unit normals (n, d), gaps (n, c), and limits (n,) for closed one-rings; collective."""
    n, around = parts
    columns = np.concatenate([n, around, np.abs(around).sum(axis=2, keepdims=True)], axis=2)
    total, d = sum_at_nodes(surface, columns), n.shape[2]
    return unit(total[:, :d]), total[:, d:-1], HALF_OF_DIGITS * total[:, -1]
