# SPDX-License-Identifier: MIT
"""Spaces, vectors and operators of one interface, for the tests of `dolfinx_mortar.mortar`."""

from mpi4py import MPI

import numpy as np

import dolfinx
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.mortar.duals import default_keep, node_weights
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.operators import integrate_matrices
from dolfinx_mortar.mortar.pairing import create_pairing
from dolfinx_mortar.mortar.surface import create_surface
from tests.cases.meshes import two_blocks


def space(mesh, degree=1):
    return dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))


def owned_coordinates(V):
    return V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, : V.mesh.geometry.dim]


def largest(values):
    """Return the largest absolute value on any rank; collective."""
    return float(maximum(MPI.COMM_WORLD, np.abs(values).max(initial=0.0))[0])


def vector_of(A, values):
    """Return a vector that A can be applied to, of such values or one of them."""
    v = A.createVecRight()
    v.array[:] = np.ravel(values)
    return v


def row_sums(mortar):
    """Return those of D and of M at the nodes of this rank, one for each component."""
    ones = vector_of(mortar.D, 1.0)
    d = mortar.D.getLocalSize()[0] // max(len(mortar.nodes), 1) or 1
    return [(A * ones).array.reshape(-1, d) for A in (mortar.D, mortar.M)]


def pair_up(V, tags, slave=3, master=4, u=None, **options):
    surfaces = create_surface(V, tags, slave, "slave"), create_surface(V, tags, master, "master")
    return create_pairing(*surfaces, u, **options)


def node_matrices(pairing, points, keep):
    """Return D and M between nodes, as PETSc matrices."""
    D, M = integrate_matrices(pairing, points, keep)
    return pairing.D.matrix(D), pairing.M.matrix(M)


def operators(pairing, u=None):
    """Return D and M of the nodes that are kept by default, and what was kept."""
    points, _ = find_segments(pairing, u)
    keep = default_keep(pairing, points, *node_weights(pairing, points))
    return *node_matrices(pairing, points, keep), keep


def bend(points):
    """Bend the upper block to an arc that touches y = 0.1."""
    result, up = points.copy(), points[:, 1] > 0.05
    angle, radius = points[up, 0] / 2, 2.1 - points[up, 1]
    result[up] = np.stack([radius * np.sin(angle), 2.1 - radius * np.cos(angle)], axis=1)
    return result


def curved(x):
    """Bend both boxes, the upper one away from the lower."""
    z = x[:, 2] + 0.2 * x[:, 0] ** 2 - 0.15 * x[:, 1] ** 2 + 0.1 * x[:, 0] * x[:, 1]
    away = np.where(x[:, 2] > 0.05, 0.1 * x[:, 0] ** 2, 0)
    return np.column_stack([x[:, :2], z + away])


def moving(partition="stripes", n=(12, 9)):
    """Return pairing of a flat and a bent side, and the mask of nodes of the upper block."""
    mesh, cells, tags = two_blocks(
        MPI.COMM_WORLD, (n[0], 1), (n[1], 1), x_lower=(-1, 1), x_upper=(-0.9, 0.9), gap=0.1,
        transform=bend, partition=partition,
    )  # fmt: skip
    V = space(mesh)
    return V, pair_up(V, tags), dolfinx.fem.locate_dofs_topological(V, 2, cells.find(2))
