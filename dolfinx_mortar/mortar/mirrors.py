# SPDX-License-Identifier: MIT
"""Which supports at the ends of a side are planes of symmetry, as the curvature of the side tells.

A support at the end of a side prescribes a component e of the displacement. If it stands for a
plane of symmetry, the side goes on as its image, so that its normal there has no component along e;
if it is a roller on which a side ends at an angle, the normal keeps that component. Dirichlet data
are the same, the side is not: towards a plane of symmetry n.e falls to zero. With the normals n_f
of the facets at the support, n_k of the smooth surface at their vertices off it, and n.e linear
along the side,

    A = sum_f n_f.e,     B = sum_f sum_k (n_k - n_f).e / (vertices of f on the support),

A - B is n.e at the support, times the number of facets. On a circle about a point of the plane
A = B, whatever the lengths of facets; a flat side and one of a single facet have B = 0.
"""

import numpy as np

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats
from dolfinx_mortar.geometry.curvature import one_ring_sums, unit
from dolfinx_mortar.geometry.facets import facet_normals
from dolfinx_mortar.mortar.surface import Surface, facets_at, sum_at_nodes


def find_mirrors(surface: Surface, fixed: Bools, feature_angle: float) -> Bools:
    """Return which prescribed components (n, d) are those of planes of symmetry, at X; collective.

    The side goes on as its image there: normals of the smooth surface, and those of contact, have
    no such component. All other prescribed components are those of supports, which take forces but
    say nothing about the shape of the side.

    Each component is judged by itself. It is that of a plane of symmetry if A and B above have the
    same sign and A is within a factor of two of B; or if the side meets the support at a right
    angle: A vanishes, or is hidden in the scatter of the n_f.e of uneven facets. A node of which
    all components are prescribed is clamped, and inside a side nothing goes on.

    Args:
        surface: the side.
        fixed: (n, d) components of its nodes with Dirichlet data.
        feature_angle: degrees between facets from which on they meet in an edge; across an edge
            nothing is known of a facet's curvature.
    """
    facets, d = facets_at(surface, surface.X), fixed.shape[1]
    n, closed = _one_rings(surface)
    vertices = surface.facets[:, list(surface.element.vertices)]
    n_f, n_k, held = facet_normals(facets), n[vertices], fixed[vertices]
    known = np.einsum("mki,mi->mk", n_k, n_f) > np.cos(np.radians(feature_angle / 2))
    turns = np.where(~held & known[:, :, None], n_k - n_f[:, None], 0.0).sum(axis=1)
    turns /= np.maximum(held.sum(axis=1), 1)
    columns = np.concatenate([n_f, turns, n_f**2, np.ones_like(n_f)], axis=1)[:, None]
    total = sum_at_nodes(surface, np.repeat(columns, surface.facets.shape[1], axis=1))
    # nodes between vertices have the mean of these; scatter is that of all facets around
    columns = np.column_stack([total[:, : 2 * d], closed])[vertices]
    between = surface.element.vertex_functions(surface.element.points) @ columns
    around = np.delete(total, np.s_[d : 2 * d], axis=1)[vertices] * np.tile(held, 3)
    around = np.repeat(around.sum(axis=1, keepdims=True), between.shape[1], axis=1)
    found = sum_at_nodes(surface, np.concatenate([between, around], axis=2))
    A, B = found[:, :d], found[:, d : 2 * d]
    is_open = found[:, [2 * d]] == 0.0
    first, square, count = np.split(found[:, 2 * d + 1 :], 3, axis=1)
    scatter = np.sqrt(np.maximum(square * count - first**2, 0.0))
    upright = np.abs(first) <= np.maximum(scatter, HALF_OF_DIGITS * count)
    curved = (A * B > 0.0) & (np.abs(A) <= 2.0 * np.abs(B)) & (np.abs(B) <= 2.0 * np.abs(A))
    return np.asarray(
        fixed & ~fixed.all(axis=1, keepdims=True) & is_open & (upright | curved), dtype=bool
    )


def _one_rings(surface: Surface) -> tuple[Floats, Bools]:
    """Return the normals (n, d) of one-rings, and which of them are closed (n,); collective."""
    parts, around = one_ring_sums(facets_at(surface, surface.X))
    columns = np.concatenate([parts, around, np.abs(around).sum(axis=2, keepdims=True)], axis=2)
    total = sum_at_nodes(surface, columns)
    d = parts.shape[2]
    gap = np.linalg.norm(total[:, d:-1], axis=1)
    return unit(total[:, :d]), np.asarray(gap <= HALF_OF_DIGITS * total[:, -1])
