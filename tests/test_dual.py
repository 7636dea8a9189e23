# SPDX-License-Identifier: MIT
"""The dual basis: biorthogonality, exact fractions, shared out functions."""

import numpy as np
import pytest

from dolfinx_mortar.geometry.facets import QUAD9, TRI6
from dolfinx_mortar.mortar.duals import ALPHA, absorbed, create_duals
from dolfinx_mortar.mortar.integrals import sums_of_values
from tests.cases.polylines import assemble

EXACT = 1e-12


def test_half_covered_facet():
    """Exact fractions; the dual basis of the whole facet would have a zero pivot here."""
    o = assemble([[1, 2], [3, 2]], [[2, 2], [0, 2]])
    assert np.abs(o.D - np.diag([0.75, 0.25])).max() < 1e-15
    assert np.abs(o.M - np.array([[9, 9], [9, -3]]) / 24).max() < 1e-15


def gauss(a, b, k):
    """Return shape function values (3, k) and weights on the part [a, b] of [-1, 1]."""
    points, weights = np.polynomial.legendre.leggauss(k + 2)
    xi = (a + b) / 2 + (b - a) / 2 * points
    if k == 2:
        N = np.stack([1 - xi, 1 + xi], axis=1) / 2
    else:
        N = np.stack([xi * (xi - 1) / 2, 1 - xi**2, xi * (xi + 1) / 2], axis=1)
    return N, weights * (b - a) / 2


@pytest.mark.parametrize("k", [2, 3])
@pytest.mark.parametrize("t", [1.0, 1e-2, 1e-6])
@pytest.mark.parametrize("end", [-1, 1])
def test_biorthogonal_where_little_is_covered(k, t, end):
    """To round-off of what is added up: two-node tips are exact, three-node ones inflate Phi."""
    a, b = (-1, -1 + 2 * t) if end < 0 else (1 - 2 * t, 1)
    N, weight = gauss(a, b, k)
    slave = np.zeros(len(weight), dtype=np.int32)
    Phi = create_duals(N, weight, slave, np.ones((1, k), dtype=bool)).Phi
    product = np.einsum("q,qi,qj->ij", weight, Phi, N)
    D = sums_of_values(N, weight, slave, 1)[0]
    error = np.abs(product - np.diag(D))
    largest = np.abs(Phi).max()
    assert error.max() < 1e-15 * largest * weight.sum()
    assert np.abs(Phi.sum(axis=1) - 1).max() < 1e-14 * largest
    if k == 2:
        assert largest < 4
        assert (error / np.sqrt(np.outer(D, D))).max() < EXACT


def test_shared_out_in_equal_parts_on_larger_facets():
    """Three nodes, one of them removed: both others take half of what theirs miss of 1."""
    N, weight = gauss(-1, 0.3, 3)
    slave, keep = np.zeros(len(weight), dtype=np.int32), np.array([[True, False, True]])
    Phi = create_duals(N, weight, slave, keep).Phi
    kept = N[:, [0, 2]]
    D = weight @ kept
    own = kept @ np.linalg.inv(kept.T @ (weight[:, None] * kept)) * D
    missing = 1 - own.sum(axis=1)
    assert np.abs(Phi[:, [0, 2]] - own - missing[:, None] / 2).max() < 1e-13


@pytest.mark.parametrize("t", [0.5, 0.2, 1e-2, 1e-4])
@pytest.mark.parametrize("far", [0, 2])
def test_functions_stay_bounded_where_the_far_vertex_is_removed(t, far):
    """Its function has a negative integral there; shared out, those of the whole basis grow."""
    a, b = (1 - 2 * t, 1) if far == 0 else (-1, -1 + 2 * t)
    N, weight = gauss(a, b, 3)
    assert weight @ N[:, far] < 1e-15
    slave, keep = np.zeros(len(weight), dtype=np.int32), np.arange(3)[None] != far
    Phi = create_duals(N, weight, slave, keep).Phi
    assert np.abs(Phi).max() < 4.0
    assert np.abs(Phi.sum(axis=1) - 1).max() < 1e-13


# -- facets of second order in space


def test_vertices_of_six_node_facets_are_the_centres_of_their_functions():
    """Which are positive in the mean; those of middles lie off their edges, on either side."""
    points, weight = TRI6.rule
    N = absorbed(TRI6.shares, TRI6.shape_functions(points))
    mean, first = weight @ N, (weight[:, None] * N).T @ points
    assert mean == pytest.approx([1 / 18] * 3 + [5 / 18] * 3, abs=1e-14)
    centres = first / mean[:, None]
    assert centres[:3] == pytest.approx(TRI6.points[:3], abs=1e-13)
    assert centres[3] == pytest.approx([2 / 5, 1 / 5], abs=1e-13)
    assert np.abs(N.sum(axis=1) - 1).max() < 1e-14


@pytest.mark.parametrize("element", [TRI6, QUAD9], ids=["six", "nine"])
@pytest.mark.parametrize("removed", [[], [1], [4], [0, 3]])
def test_six_and_nine_nodes_are_biorthogonal(element, removed):
    """D has its diagonal and what middles lean on; rows of removed nodes vanish."""
    points, weight = element.rule
    keep = np.ones((1, element.nodes), dtype=bool)
    keep[0, removed] = False
    slave, N = np.zeros(len(weight), dtype=np.int32), element.shape_functions(points)
    mine = absorbed(element.shares, N, keep[slave])
    Phi = create_duals(mine, weight, slave, keep).Phi
    D = (weight[:, None] * Phi).T @ N
    expected = np.diag(np.diag(D))
    for middle, *ends in element.shares:
        expected[middle, ends] = -ALPHA * D[middle, middle]
    k = keep[0]
    assert np.abs(D - expected)[np.ix_(k, k)].max() < 1e-14
    assert (np.diag(D)[k] > 0.01).all() and np.abs(D[~k]).max(initial=0.0) == 0.0
    assert np.abs(Phi.sum(axis=1) - 1).max() < 1e-12
