# SPDX-License-Identifier: MIT
"""Two sides in one configuration: relative motions, gaps, and the transpose of both."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import sums_at_nodes
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.coupling import Coupling, Pattern, Sides
from dolfinx_mortar.mortar.operators import MortarOperators
from dolfinx_mortar.mortar.pairing import Pairing


@dataclass(frozen=True)
class CoupledSides:
    """The sides of an interface with what a search and an update have found for them."""

    sides: Sides
    pairing: Pairing | None  # of the two surfaces; None without a master
    pattern: Pattern
    coupling: Coupling
    near: Bools  # (n,) slave nodes that take part in the change of basis
    banned: Bools  # (local nodes,) slave nodes that another interface has

    @property
    def nodes(self) -> Ints:
        """Local numbers (n,) of the slave nodes that this rank owns."""
        return self.sides.nodes

    @property
    def mortar(self) -> tuple[Pairing, MortarOperators]:
        """The pairs of facets and the operators on them, of a link with a master."""
        assert self.pairing is not None and self.coupling.operators is not None
        return self.pairing, self.coupling.operators

    @property
    def Q(self) -> PETSc.Mat:
        """The matrix Q; its memory is that of all configurations of the same pattern."""
        return self.pattern.blocks.of(self.coupling.blocks)

    @property
    def constrained(self) -> Bools:
        """Which directions of the frames (n, d) are constrained in the change of basis."""
        return np.asarray(self.coupling.directions & self.near[:, None])

    @property
    def slot(self) -> Ints:
        """Column of the frames in use (n, d) that is a prescribed Cartesian direction, else -1."""
        axes = np.arange(self.coupling.slot.shape[1], dtype=np.int32)
        left = np.where(self.sides.fixed[self.nodes], axes, -1)
        bound = np.asarray(self.constrained.any(axis=1))[:, None]
        return np.where(bound, self.coupling.slot, left).astype(np.int32)

    @property
    def frames(self) -> Floats:
        """Frames in use (n, d, d): Cartesian ones where nothing is bound."""
        bound = np.asarray(self.constrained.any(axis=1))[:, None, None]
        return np.where(bound, self.coupling.R, np.eye(self.coupling.R.shape[1]))

    def relative(self, v: PETSc.Vec) -> Floats:
        """Return R^T (v_j - sum_l Q_jl v_l) at the owned slave nodes, (n, d); collective.

        In constrained directions this is the relative motion of the two sides, R_j^T (v_j - P v).
        """
        difference = v.array_r - (self.Q * v).array_r
        local = difference.reshape(-1, self.coupling.R.shape[1])[self.nodes]
        return np.asarray(np.einsum("nij,ni->nj", self.coupling.R, local))

    def gaps(self, v: PETSc.Vec) -> Floats:
        """Return n_j.(P v - v_j) - h_j at the owned slave nodes (n,) for v = X + u; collective.

        The distance to the master along the normal. h_j is the mean height of smooth surfaces;
        where there is no master, P = 0 and -h_j is its place along the normal.
        """
        normals = self.coupling.normals
        moved = (self.Q * v).array_r - v.array_r
        along = (moved.reshape(-1, normals.shape[1])[self.nodes] * normals).sum(axis=1)
        return np.asarray(along - self.coupling.heights)

    def constrained_motion(self, v: PETSc.Vec) -> Floats:
        """Return the constrained components of the relative motion, near or far; collective."""
        return np.asarray(self.relative(v)[self.coupling.directions])

    def transpose(self, forces: Floats) -> tuple[Floats, Floats]:
        """Return the owned nodal forces (I - Q)^T v of slave forces v (n, d); collective.

        Those on the slave side (of I and D) and those on the master side (of M), which meet at
        nodes of both. Their sum is (I - Q)^T v.
        """
        p, V = self.pattern, self.sides.V
        moved = -np.einsum("eij,ei->ej", self.coupling.blocks, forces[p.row])
        slave, master = (
            sums_at_nodes(V.mesh.comm, V.dofmap.index_map, p.column[part], moved[part])
            for part in (slice(None, p.split), slice(p.split, None))
        )
        slave[self.nodes] += forces
        return slave, master


def relative_motions(coupled: CoupledSides, v: PETSc.Vec) -> Floats:
    """Return D^-1 (D - M) v (c, n, d) at the slave nodes for each choice of nodes; collective.

    With the D and M of the last update that belong to the choice, zero at nodes that it leaves out.
    """
    P, coupling = coupled.pattern.scalars, coupled.coupling
    result = np.zeros((coupling.P.shape[1], *coupling.normals.shape))
    for c in range(len(result)):
        P.fill(coupling.P[:, c, None, None])
        result[c] = node_motions(coupled, P.matrix, v)
    return np.where(coupling.kept.T[:, :, None], result, 0.0)


def node_motions(coupled: CoupledSides, P: PETSc.Mat, v: PETSc.Vec) -> Floats:
    """Return v_j - sum_l P_jl v_l (n, d) at the slave nodes, of a P between nodes; collective."""
    d = coupled.coupling.normals.shape[1]
    w, result = P.createVecRight(), np.zeros((len(coupled.nodes), d))
    for i in range(d):
        w.array[:] = v.array_r[i::d]
        result[:, i] = (w.array_r - (P * w).array_r)[coupled.nodes]
    return result


def along_and_across(relative: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return the normal part and the length of the tangential part of motions (.., d).

    >>> along_and_across(np.array([[3.0, -2.0]]), np.array([[0.0, 1.0]]))
    (array([-2.]), array([3.]))
    """
    along = (relative * normals).sum(axis=-1)
    return along, np.linalg.norm(relative - along[..., None] * normals, axis=-1)


def slipped(coupled: CoupledSides, u: PETSc.Vec) -> Floats:
    """Return how far the slave nodes (n,) have moved along the master, tangentially; collective.

    That is the tangential part of D^-1 (D - M) u, of the choice in which it is largest.
    """
    _, across = along_and_across(relative_motions(coupled, u), coupled.coupling.normals)
    return np.asarray(across.max(axis=0))
