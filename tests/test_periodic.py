# SPDX-License-Identifier: MIT
"""Ties across a periodic cell: uniform strain, and the mean stress of a laminate."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import create_unit_square, locate_entities, meshtags

E, NU, LAYER = (100.0, 10.0), 0.3, 0.4  # from y = 0 to LAYER, and above
H = np.array([[0.01, 0.004], [0.002, -0.02]])


def laminate():
    """Return the columns x and y of the mean stress: two equations at each of both layers."""
    lame, mu = E[0] * NU / (1 + NU) / (1 - 2 * NU), E[0] / 2 / (1 + NU)
    lame, mu = (np.array([a, a * E[1] / E[0]]) for a in (lame, mu))
    share, stiff = np.array([LAYER, 1 - LAYER]), lame + 2 * mu
    across = (H[1, 1] + H[0, 0] * share @ (lame / stiff)) / (share @ (1 / stiff))
    shear = (H[0, 1] + H[1, 0]) / (share @ (1 / mu))
    strain = (across - lame * H[0, 0]) / stiff
    return np.array([[share @ (stiff * H[0, 0] + lame * strain), shear], [shear, across]])


def stress(E, shift, degree=1, n=5):
    """Return the mean stress of a cell whose nodes are shifted on the right and at the top."""
    mesh = create_unit_square(MPI.COMM_WORLD, n, n)
    x, y = mesh.geometry.x[:, 0].copy(), mesh.geometry.x[:, 1].copy()
    mesh.geometry.x[:, 1] += shift * x * y * (y - LAYER) * (1 - y)
    mesh.geometry.x[:, 0] += shift * y * x * (1 - x)
    sides = [locate_entities(mesh, 1, lambda x, i=i, at=at: abs(x[i] - at) < 1e-9)
             for i in range(2) for at in (0.0, 1.0)]  # fmt: skip
    values = np.repeat(np.arange(4, dtype=np.int32), [len(side) for side in sides])
    order = np.argsort(np.concatenate(sides))
    facets = meshtags(mesh, 1, np.concatenate(sides)[order], values[order])
    cells = np.arange(mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts)
    low = locate_entities(mesh, 2, lambda x: x[1] < LAYER + 1e-9)
    layers = meshtags(mesh, 2, cells.astype(np.int32), np.isin(cells, low).astype(np.int32))
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    solid = dm.Solid(fem.Function(V), {1: dm.Elastic(E[0], NU), 0: dm.Elastic(E[1], NU)}, layers)
    ties = [
        dm.Tie(facets, slave=2 * i + 1, master=2 * i, jump=H[:, i], surface="facets", within=np.inf)
        for i in range(2)
    ]
    corner = fem.locate_dofs_geometrical(V, lambda x: x[0] + x[1] < 1e-9)
    problem = dm.ContactProblem(solid, ties, bcs=[fem.dirichletbc(np.zeros(2), corner, V)])
    dm.newton(problem, rtol=1e-12)
    return np.column_stack([tie.force for tie in ties])


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_uniform_strain(degree):
    """A patch test across the cell, with corners that belong to two ties."""
    mu = E[0] / 2 / (1 + NU)
    strain = (H + H.T) / 2
    exact = 2 * mu * strain + 2 * mu * NU / (1 - 2 * NU) * np.trace(strain) * np.eye(2)
    assert stress((E[0], E[0]), 0.8, degree) == pytest.approx(exact, abs=1e-10)


@pytest.mark.mpi
def test_a_laminate():
    """Exact with sides that match, else up to the jump of the traction between the layers."""
    assert stress(E, 0.0) == pytest.approx(laminate(), abs=1e-10)
    assert stress(E, 0.8) == pytest.approx(laminate(), abs=1e-3 * abs(laminate()).max())
