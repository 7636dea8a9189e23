# SPDX-License-Identifier: MIT
"""Types of facets: their data are consistent, and no other module depends on the type."""

import numpy as np
import pytest

import basix
import dolfinx
from dolfinx_mortar.common.spaces import CELLS, HIGHEST
from dolfinx_mortar.geometry import plane as parts_module
from dolfinx_mortar.geometry.facets import (
    FACETS_OF,
    LINE2,
    LINE3,
    QUAD4,
    QUAD9,
    TRI3,
    TRI6,
    Facets,
    area_vectors,
    normals_at_nodes,
    points_of,
    tributary_weights,
)
from dolfinx_mortar.geometry.plane import (
    coefficients,
    meet,
)

ELEMENTS = pytest.mark.parametrize("element", [LINE2, TRI3, QUAD4, LINE3, TRI6, QUAD9])


def nodes(element):
    """Return the reference points of the nodes (k, d-1): where the functions are 0 and 1."""
    cell = getattr(basix.CellType, element.cell)
    lagrange = basix.create_element(
        basix.ElementFamily.P, cell, element.degree, basix.LagrangeVariant.equispaced
    )
    points = lagrange.points[list(element.order)]
    return points if element.cell == "triangle" else 2 * points - 1


@ELEMENTS
def test_functions_are_nodal_in_dolfinx_order(element):
    """N_i(xi_j) = delta_ij where node i on the way around is dolfinx's node order[i]."""
    x = nodes(element)
    assert np.abs(element.points - x).max() < 1e-15
    assert np.abs(element.shape_functions(x) - np.eye(element.nodes)).max() < 1e-15
    v = list(element.vertices)
    assert v == list(range(len(v)))
    assert np.abs(element.first.shape_functions(x[v]) - np.eye(len(v))).max() < 1e-15


@ELEMENTS
def test_rule_integrates_the_functions(element):
    """First-order functions have the same integral each; the weights add up to one."""
    points, weights = element.rule
    assert weights.sum() == pytest.approx(1.0, abs=1e-15)
    expected = MEANS.get(element, 1 / element.nodes)
    assert weights @ element.shape_functions(points) == pytest.approx(expected, abs=1e-15)


MEANS = {  # Simpson's, and nothing at the vertices of a triangle
    LINE3: np.array([1, 1, 4]) / 6,
    TRI6: np.array([0, 0, 0, 1, 1, 1]) / 3,
    QUAD9: np.array([1, 1, 1, 1, 4, 4, 4, 4, 16]) / 36,
}


def test_weights_of_a_bilinear_facet():
    """Trapezium of heights 1 and 3 over [0, 1]: int (1 - x)(1 + 2 x) / 2 dx."""
    x = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 3, 0], [0, 1, 0]]])
    expected = np.array([5, 7, 7, 5]) / 12
    assert tributary_weights(Facets(QUAD4, x))[0] == pytest.approx(expected, abs=1e-14)


def test_curved_facets_have_the_normals_and_the_length_of_the_parabola():
    """Y = x^2 / 2 on [0, 1]: slopes at the nodes, and the arc length (closed form)."""
    facets = Facets(LINE3, np.array([[[0.0, 0.0], [1.0, 0.5], [0.5, 0.125]]]))
    slope = np.array([0.0, 1.0, 0.5])
    expected = np.stack([slope, -np.ones(3)], axis=1) / np.sqrt(1 + slope**2)[:, None]
    assert np.abs(normals_at_nodes(facets)[0] - expected).max() < 1e-15
    length = (np.sqrt(2) + np.arcsinh(1.0)) / 2
    assert tributary_weights(facets).sum() == pytest.approx(length, abs=1e-8)
    assert (area_vectors(facets) == [[0.5, -1.0]]).all()


def test_every_cell_that_u_may_have_has_the_facets_of_dolfinx():
    assert FACETS_OF.keys() == {(c, degree) for c in CELLS for degree in range(1, HIGHEST + 1)}
    for (cell, degree), facet in FACETS_OF.items():
        kind = dolfinx.mesh.to_type(cell)
        expected = dolfinx.cpp.mesh.cell_entity_type(kind, dolfinx.cpp.mesh.cell_dim(kind) - 1, 0)
        assert (expected.name, degree) == (facet.cell, facet.degree)


@pytest.mark.parametrize("element", [TRI6, QUAD9])
def test_newton_reaches_curved_facets_or_says_so(element, monkeypatch):
    """To round-off from a tenth away, also where facets turn by 90 degrees; else NaN."""
    xi = element.points if element.bilinear else element.points - 0.3
    at = np.random.default_rng(8).uniform(0.0, 0.3, (6, 2))
    x = np.column_stack([at + 0.5, np.full(6, -1.0)])  # lines aslant

    def found(facets, x, n):
        for a, point, way in zip(at + 0.1, x, n, strict=True):
            tangents = np.linalg.svd(way[None])[2][1:]
            P = (tangents @ coefficients(facets)[0])[None]
            yield parts_module.meet(P, *(tangents @ point), *a)

    for bend in (1.0, 10.0):
        height = bend * (0.1 * xi[:, 0] ** 2 - 0.07 * xi[:, 0] * xi[:, 1])
        facets = Facets(element, np.column_stack([xi, height])[None])
        n = x - points_of(facets, np.zeros(6, dtype=np.int32), at)
        assert np.abs(np.array([*found(facets, x, n)]) - at).max() < 1e-13
        monkeypatch.setattr(parts_module, "LIMIT", 2)  # as Python sees the number
        monkeypatch.setattr(parts_module, "meet", meet.py_func)
        assert np.isnan([*found(facets, x, n)]).all()
        monkeypatch.undo()
    aside = x + np.array([100.0, 0.0, -1e3])
    assert np.isnan([*found(facets, aside, np.tile([0.1, 0.0, 1.0], (6, 1)))]).all()
