# SPDX-License-Identifier: MIT
"""Spaces, vectors and operators of one interface, for the tests of `dolfinx_mortar.mortar`."""

import numpy as np

import dolfinx
from dolfinx_mortar.mortar.duals import default_keep, node_weights
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.operators import integrate_matrices
from dolfinx_mortar.mortar.pairing import create_pairing
from dolfinx_mortar.mortar.surface import create_surface


def space(mesh):
    return dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))


def owned_coordinates(V):
    return V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, :2]


def vector_of(A, values):
    """Return a vector that A can be applied to."""
    v = A.createVecRight()
    v.array[:] = np.ravel(values)
    return v


def pair_up(V, tags, slave, master, u=None):
    surfaces = create_surface(V, tags, slave, "slave"), create_surface(V, tags, master, "master")
    return create_pairing(V, *surfaces, u)


def node_matrices(pairing, points, keep):
    """Return D and M between nodes, as PETSc matrices."""
    D, M = integrate_matrices(pairing, points, keep)
    return pairing.D.matrix(D), pairing.M.matrix(M)


def operators(pairing, u=None):
    """Return D and M of the nodes that are kept by default, and what was kept."""
    points, _ = find_segments(pairing, u)
    keep = default_keep(pairing, points, *node_weights(pairing, points))
    return *node_matrices(pairing, points, keep), keep
