# SPDX-License-Identifier: MIT
"""Flats that meet fillets, and fillets of other radii: smooth surfaces whose curvature jumps."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.geometry.curvature import edge_sagittas, edges
from dolfinx_mortar.mortar.curvature_correction import smooth_normals
from dolfinx_mortar.mortar.surface import create_surface, facets_at
from tests.cases.close_fits import nested, ring_cells
from tests.cases.two_bodies import create_problem, held

COMM = MPI.COMM_WORLD
FIT = 0.01
QUARTER = np.pi / 2


def outline(pieces, counts, grading=0.0):
    """Return nodes (n, 2) along a closed line of pieces of (length, curvature), anticlockwise."""
    nodes, at, angle = [], np.zeros(2), QUARTER
    for (length, curvature), count in zip(pieces, counts, strict=True):
        s = np.linspace(0.0, 1.0, count + 1)
        s = length * (s + grading * np.sin(np.pi * s) * s * (1 - s))
        turned = curvature * s
        along = s * np.sinc(turned / 2 / np.pi)  # the chord
        way = angle + turned / 2
        part = at + along[:, None] * np.column_stack([np.cos(way), np.sin(way)])
        nodes.append(part[:-1])
        at, angle = part[-1], angle + curvature * length
    found = np.concatenate(nodes)
    assert np.abs(at).max() < 1e-12
    return found - (found.max(axis=0) + found.min(axis=0)) / 2


def rectangle(grow=0.0):
    fillet = (QUARTER * (2.0 + grow), 1 / (2.0 + grow))
    return [(6.0, 0.0), fillet, (12.0, 0.0), fillet] * 2


def oval():
    return [(2.0 * QUARTER, 0.5), (5.0 * QUARTER, 0.2)] * 2


def body(inner, outer, layers):
    """Return nodes and quadrilaterals between two outlines of as many nodes."""
    shares = np.linspace(0.0, 1.0, layers + 1)[:, None, None]
    x = (1 - shares) * inner + shares * outer
    return x.reshape(-1, 2), ring_cells(len(inner), layers)


def fit(peg, hole, layers=1):
    """Return the space and the tags of a peg in a plate, both with holes; tags 1 to 4."""
    parts = [body(0.4 * peg, peg, layers), body(hole, 1.6 * hole, layers)]
    domain, tags = nested(COMM, parts)
    return fem.functionspace(domain, ("Lagrange", 1, (2,))), tags


def normals_of(nodes, tag=2):
    """Return the surface of an outline, its facets and normals."""
    V, tags = fit(nodes, 1.5 * nodes)
    surface = create_surface(V, tags, tag, "slave")
    none = np.zeros((len(surface.nodes), 2), dtype=bool)
    return surface, facets_at(surface, surface.X), smooth_normals(surface, surface.X, none, 40.0)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("pieces", "counts"),
    [(rectangle(), (4, 3, 7, 5) * 2), (rectangle(), (3, 12, 5, 4) * 2), (oval(), (4, 6) * 2)],
)
@pytest.mark.parametrize("grading", [0.0, 0.5])
@pytest.mark.parametrize("tag", [2, 3])
def test_each_side_of_a_jump_has_its_own_curvature(pieces, counts, grading, tag):
    """Flats are flat up to their ends, arcs are arcs, on any mesh; of pegs and of holes."""
    surface, facets, normals = normals_of(outline(pieces, counts, grading), tag)
    sign, scale = (1.0, 1.0) if tag == 2 else (-1.0, 1.5)
    length = np.linalg.norm(edges(facets)[:, 0], axis=1)
    curvature = sign * edge_sagittas(facets, normals, surface.facets)[:, 0] / length**2
    known = np.unique([c for _, c in pieces]) / scale
    assert np.abs(curvature[:, None] - known).min(axis=1).max(initial=0.0) < 1e-9
    assert normals.jumps is not None
    jumps = COMM.allreduce(int(normals.jumps[: surface.owned].sum()))
    assert jumps == len(pieces)


def ellipse(aspect, count, spread, seed=0):
    """Return nodes (n, 2) of an ellipse, displaced at random by shares of the facets."""
    t = np.arange(count) + np.random.default_rng(seed).uniform(-spread, spread, count)
    t *= 2 * np.pi / count
    return np.column_stack([aspect * np.cos(t), np.sin(t)])


@pytest.mark.mpi
@pytest.mark.parametrize("aspect", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("count", [32, 60])
@pytest.mark.parametrize("spread", [0.0, 0.25])
def test_what_varies_smoothly_does_not_jump(aspect, count, spread):
    """Circles and ellipses on coarse meshes, even or not."""
    surface, facets, normals = normals_of(ellipse(aspect, count, spread))
    assert normals.jumps is not None and not normals.jumps.any()
    if aspect == 1.0:
        c = edge_sagittas(facets, normals, surface.facets)[:, 0]
        assert c == pytest.approx((edges(facets)[:, 0] ** 2).sum(axis=1), rel=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("slave", [2, 3])
def test_a_press_fit_presses_everywhere(slave):
    """Beside the ends of the flats as well: 111 to 206 (216) on meshes four times as fine."""
    counts = {"peg": (6, 6, 12, 6) * 2, "hole": (8, 8, 14, 8) * 2}
    V, tags = fit(outline(rectangle(FIT), counts["peg"]), outline(rectangle(), counts["hole"]), 4)
    contact = dm.Contact(tags, slave=slave, master=5 - slave)
    bcs = [held(V, tags, tag) for tag in (1, 4)]
    problem = create_problem(V, [contact], bcs, dm.Elastic(70e3, 0.3))
    dm.newton(problem)
    nodes = contact.gather(problem.u)
    assert (nodes["active"] == 1.0).all()
    least, most = (f(nodes["pressure"]) for f in (np.min, np.max))
    assert 107.0 < least < 112.0 and 180.0 < most < 200.0
