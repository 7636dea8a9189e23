# SPDX-License-Identifier: MIT
"""Relative motions of the two sides of an interface by D and M, and their parts."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.link import Link


def relative_motions(link: Link, v: PETSc.Vec) -> Floats:
    """Return D^-1 (D - M) v (c, n, d) at the slave nodes for each choice of nodes; collective.

    With the D and M of the last update that belong to the choice, zero at nodes that it leaves out.
    """
    P, coupling = link.pattern.scalars, link.coupling
    result = np.zeros((coupling.P.shape[1], *coupling.normals.shape))
    for c in range(len(result)):
        P.fill(coupling.P[:, c, None, None])
        result[c] = node_motions(link, P.matrix, v)
    return np.where(coupling.kept.T[:, :, None], result, 0.0)


def node_motions(link: Link, P: PETSc.Mat, v: PETSc.Vec) -> Floats:
    """Return v_j - sum_l P_jl v_l (n, d) at the slave nodes, of a P between nodes; collective."""
    d = link.coupling.normals.shape[1]
    w, result = P.createVecRight(), np.zeros((len(link.nodes), d))
    for i in range(d):
        w.array[:] = v.array_r[i::d]
        result[:, i] = (w.array_r - (P * w).array_r)[link.nodes]
    return result


def along_and_across(relative: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return the normal part and the length of the tangential part of motions (.., d).

    >>> along_and_across(np.array([[3.0, -2.0]]), np.array([[0.0, 1.0]]))
    (array([-2.]), array([3.]))
    """
    along = (relative * normals).sum(axis=-1)
    return along, np.linalg.norm(relative - along[..., None] * normals, axis=-1)


def slipped(link: Link, u: PETSc.Vec) -> Floats:
    """Return how far the slave nodes (n,) have moved along the master, tangentially; collective.

    That is the tangential part of D^-1 (D - M) u, of the choice in which it is largest.
    """
    _, across = along_and_across(relative_motions(link, u), link.coupling.normals)
    return np.asarray(across.max(axis=0))
