# SPDX-License-Identifier: MIT
"""Types of facets: what one says about itself is consistent, and nobody else knows it."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import basix
import dolfinx
import dolfinx_mortar
from dolfinx_mortar.geometry.elements import FACETS_OF, LINE2, QUAD4, TRI3
from dolfinx_mortar.geometry.facets import (
    Facets,
    area_vectors,
    facet_normals,
    surface_gradients,
    tributary_weights,
)
from dolfinx_mortar.geometry.segments import create_segments
from dolfinx_mortar.mortar.dual import BASES
from dolfinx_mortar.spaces import CELLS

ELEMENTS = pytest.mark.parametrize("element", [LINE2, TRI3, QUAD4], ids=lambda e: e.cell)
PACKAGE = Path(dolfinx_mortar.__file__).parent


def nodes(element):
    """Return the reference points of the nodes (k, d-1): where the functions are 0 and 1."""
    cell = getattr(basix.CellType, element.cell)
    points = basix.geometry(cell)[list(element.order)]
    return points if element.cell == "triangle" else 2 * points - 1


@ELEMENTS
def test_functions_are_nodal_in_dolfinx_order(element):
    """N_i(xi_j) = delta_ij where node i on the way around is dolfinx's node order[i]."""
    assert np.abs(element.shape_functions(nodes(element)) - np.eye(element.nodes)).max() < 1e-15


@ELEMENTS
def test_partition_of_unity_and_linear_fields(element):
    xi = nodes(element).mean(axis=0) + 0.1 * np.random.default_rng(0).uniform(
        -1, 1, (7, len(nodes(element)[0]))
    )
    N = element.shape_functions(xi)
    assert np.abs(N.sum(axis=1) - 1).max() < 1e-15
    assert np.abs(N @ nodes(element) - xi).max() < 1e-15


@ELEMENTS
def test_derivatives(element):
    """Of first order, so that differences over any step in one direction are exact."""
    xi = np.random.default_rng(3).uniform(0, 0.4, (7, len(nodes(element)[0])))
    for a, step in enumerate(0.5 * np.eye(xi.shape[1])):
        up, down = (element.shape_functions(xi + s * step) for s in (1, -1))
        assert np.abs(element.derivatives(xi)[:, :, a] - (up - down)).max() < 1e-15


@ELEMENTS
def test_surface_gradients(element):
    """They have no normal part, and those of the position are the tangents' projection."""
    rng = np.random.default_rng(4)
    d = nodes(element).shape[1] + 1
    x = np.concatenate([nodes(element), np.zeros((element.nodes, 1))], axis=1)
    facets = Facets(element, x + rng.uniform(-0.2, 0.2, (5, element.nodes, d)))
    which, xi = np.arange(5, dtype=np.int32), rng.uniform(0, 0.4, (5, d - 1))
    g, n = surface_gradients(facets, which, xi)
    tangents = np.eye(d) - n[:, :, None] * n[:, None]
    assert np.abs(np.einsum("qli,qlj->qij", facets.x, g) - tangents).max() < 1e-13
    assert np.abs(g.sum(axis=1)).max() < 1e-13
    assert ((n * facet_normals(facets)).sum(axis=1) > 0.5).all()


@ELEMENTS
def test_rule_integrates_the_functions(element):
    """First-order functions have the same integral each; the weights add up to one."""
    points, weights = element.rule
    assert weights.sum() == pytest.approx(1.0, abs=1e-15)
    assert weights @ element.shape_functions(points) == pytest.approx(1 / element.nodes, abs=1e-15)


@ELEMENTS
def test_vertices_and_linear_parts(element):
    """First-order facets are clipped as they are."""
    assert element.vertices == tuple(range(element.nodes))
    assert element.sub_facets == (element.vertices,)
    x = np.random.default_rng(1).uniform(-1, 1, (5, element.nodes, 3))
    assert (Facets(element, x).linear == x).all()
    assert Facets(element, x[:0]).linear.shape == (0, element.nodes, 3)
    assert element.multiplier in BASES


@ELEMENTS
def test_mirrored_facets_have_the_opposite_normal(element):
    d = nodes(element).shape[1] + 1
    x = np.random.default_rng(2).uniform(-1, 1, (5, element.nodes, d))
    normals = facet_normals(Facets(element, x))
    assert np.abs(facet_normals(Facets(element, x[:, element.mirrored])) + normals).max() < 1e-14


@ELEMENTS
def test_weights_add_up_to_the_area(element):
    """On plane convex facets; on the bilinear one, each N_j by its closed form."""
    plane = nodes(element) * [1.0, 0.5][: nodes(element).shape[1]]
    x = np.column_stack([plane, 0.3 * plane[:, 0]])[None]
    facets = Facets(element, x)
    area = np.linalg.norm(area_vectors(facets), axis=1)
    assert tributary_weights(facets) == pytest.approx(area[0] / element.nodes, abs=1e-15)
    if element is QUAD4:  # trapezium of heights 1 and 3 over [0, 1]: int (1 - x)(1 + 2 x) / 2 dx
        x = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 3, 0], [0, 1, 0]]])
        expected = np.array([5, 7, 7, 5]) / 12
        assert tributary_weights(Facets(element, x))[0] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("cell", sorted(FACETS_OF))
def test_every_cell_has_the_facets_of_dolfinx(cell):
    kind = dolfinx.mesh.to_type(cell)
    facet = dolfinx.cpp.mesh.cell_entity_type(kind, dolfinx.cpp.mesh.cell_dim(kind) - 1, 0)
    assert facet.name == FACETS_OF[cell].cell


def test_every_cell_that_u_may_have_has_facets():
    assert set(CELLS) == FACETS_OF.keys()


def test_facets_of_several_linear_ones_are_refused():
    """Their operators would be those of other facets: segments carry the number of the facet."""
    line3 = replace(LINE2, nodes=3, sub_facets=((0, 2), (2, 1)))
    facets = Facets(line3, np.array([[[0.0, 0.0], [2.0, 0.0], [1.0, 0.1]]]))
    normals = np.tile([0.0, -1.0], (1, 3, 1))
    pairs = np.zeros((1, 2), dtype=np.int32)
    with pytest.raises(NotImplementedError, match="2 linear ones"):
        create_segments(facets, normals, facets, pairs)


def counts(tree):
    """Yield comparisons that tell a type from a count, such as x.shape[1] == 3 or n > 3.

    Fewer than three vertices are no polygon: that is no type.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            texts = [ast.unparse(side) for side in sides]
            size = any(".shape[0]" in text or ".shape[1]" in text for text in texts)
            name = any(isinstance(side, ast.Name) for side in sides)
            empty = isinstance(node.ops[0], ast.Lt) and texts[1] == "3"
            if (size and {"1", "3", "4", "6", "8"} & set(texts)) or (
                name and not empty and {"3", "4", "6", "8"} & set(texts)
            ):
                yield ast.unparse(node)


def test_types_told_from_counts_are_found():
    text = "x.shape[1] == 3; kept.shape[1] == 1; n > 3; k == 4; n < 3; len(x) > 0; x.shape[2] == 2"
    assert list(counts(ast.parse(text))) == text.split("; ")[:4]


@pytest.mark.parametrize("floor", ["geometry", "mortar", "interfaces"])
def test_no_type_is_told_from_a_number_of_nodes(floor):
    for file in sorted((PACKAGE / floor).glob("*.py")):
        assert not list(counts(ast.parse(file.read_text()))), file
