# SPDX-License-Identifier: MIT
"""Ties across a periodic cell: uniform strain, and the mean stress of a laminate."""

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import (
    CellType,
    create_unit_cube,
    create_unit_square,
    locate_entities,
    meshtags,
)

E, NU, LAYER = (100.0, 10.0), 0.3, 0.4  # from y = 0 to LAYER, and above
H = np.array([[0.01, 0.004, 0.003], [0.002, -0.02, -0.001], [0.005, 0.002, 0.006]])


def laminate():
    """Return the columns x and y of the mean stress: two equations at each of both layers."""
    lame, mu = E[0] * NU / (1 + NU) / (1 - 2 * NU), E[0] / 2 / (1 + NU)
    lame, mu = (np.array([a, a * E[1] / E[0]]) for a in (lame, mu))
    share, stiff = np.array([LAYER, 1 - LAYER]), lame + 2 * mu
    across = (H[1, 1] + H[0, 0] * share @ (lame / stiff)) / (share @ (1 / stiff))
    shear = (H[0, 1] + H[1, 0]) / (share @ (1 / mu))
    strain = (across - lame * H[0, 0]) / stiff
    return np.array([[share @ (stiff * H[0, 0] + lame * strain), shear], [shear, across]])


def stress(E, shift, degree=1, d=2):
    """Return the mean stress of a cell whose sides at x_i = 1 have shifted nodes."""
    shape = {2: create_unit_square, 3: partial(create_unit_cube, cell_type=CellType.hexahedron)}
    mesh = shape[d](MPI.COMM_WORLD, *[5] * d)
    x = mesh.geometry.x[:, :d].copy()
    for i in range(d):
        inside = np.prod([x[:, k] * (1 - x[:, k]) for k in range(d) if k != i], axis=0)
        along = (x[:, 1] - LAYER) if (i + 1) % d == 1 else 1.0
        mesh.geometry.x[:, (i + 1) % d] += shift * 4 ** (d - 2) * x[:, i] * inside * along
    sides = [locate_entities(mesh, d - 1, lambda x, i=i, at=at: abs(x[i] - at) < 1e-9)
             for i in range(d) for at in (0.0, 1.0)]  # fmt: skip
    values = np.repeat(np.arange(2 * d, dtype=np.int32), [len(side) for side in sides])
    order = np.argsort(np.concatenate(sides))
    facets = meshtags(mesh, d - 1, np.concatenate(sides)[order], values[order])
    cells = np.arange(mesh.topology.index_map(d).size_local + mesh.topology.index_map(d).num_ghosts)
    low = locate_entities(mesh, d, lambda x: x[1] < LAYER + 1e-9)
    layers = meshtags(mesh, d, cells.astype(np.int32), np.isin(cells, low).astype(np.int32))
    V = fem.functionspace(mesh, ("Lagrange", degree, (d,)))
    solid = dm.Solid(fem.Function(V), {1: dm.Elastic(E[0], NU), 0: dm.Elastic(E[1], NU)}, layers)
    options = {"surface": "facets", "within": np.inf}
    ties = [
        dm.Tie(facets, slave=2 * i + 1, master=2 * i, jump=H[:d, i], **options) for i in range(d)
    ]
    corner = fem.locate_dofs_geometrical(V, lambda x: x.sum(axis=0) < 1e-9)
    problem = dm.ContactProblem(solid, ties, bcs=[fem.dirichletbc(np.zeros(d), corner, V)])
    dm.newton(problem, rtol=1e-12)
    return np.column_stack([tie.force[:d] for tie in ties])


@pytest.mark.mpi
@pytest.mark.parametrize(("d", "degree"), [(2, 1), (2, 2), (3, 1)])
def test_uniform_strain(d, degree):
    """A patch test across the cell, with corners and edges that belong to several ties."""
    mu, h = E[0] / 2 / (1 + NU), H[:d, :d]
    strain = (h + h.T) / 2
    exact = 2 * mu * strain + 2 * mu * NU / (1 - 2 * NU) * np.trace(strain) * np.eye(d)
    assert stress((E[0], E[0]), 0.8, degree, d) == pytest.approx(exact, abs=1e-10)


@pytest.mark.mpi
def test_a_laminate():
    """Exact with sides that match, else up to the jump of the traction between the layers."""
    assert stress(E, 0.0) == pytest.approx(laminate(), abs=1e-10)
    assert stress(E, 0.8) == pytest.approx(laminate(), abs=1e-3 * abs(laminate()).max())
