# SPDX-License-Identifier: MIT
"""What multigrid works on: the tangent in unknowns in which open contacts let the bodies go."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.qp import Change, Preconditioning
from dolfinx_mortar.supports.bodies import Bodies, rigid_motions
from dolfinx_mortar.supports.dirichlet import Dirichlet


class UnknownsOfBodies:
    """The unknowns of multigrid: those of the QP, changed back where contact is open.

    The near-null space are the rigid motions of the whole. In the unknowns of the QP they have
    w_n = 0 at all covered slave nodes, which is right only where contact is closed; where it is
    open, the unknowns are changed back (`Transformation.uncouple`).

    Args:
        K: the tangent.
        system: the interfaces, with T up to date.
        supports: the Dirichlet conditions.
        bodies: the connected parts of the mesh.
    """

    def __init__(
        self, K: PETSc.Mat, system: InterfaceSystem, supports: Dirichlet, bodies: Bodies
    ) -> None:
        """Keep what changes by itself."""
        self.system, self.supports, self.bodies = system, supports, bodies
        self.operator = CongruentOperator(K)

    def preconditioning(self, held: Ints) -> Preconditioning:
        """Return what is needed for a set-up; collective.

        Args:
            held: owned unknowns of y that are held at their bounds.
        """
        T, change = self.system.transformation, self.change(held)
        motions = rigid_motions(self.bodies)
        if T is not None:
            motions = [T.uncoupled(motion, change.E) for motion in motions]
        for motion in motions:
            motion.array[self.operator.decoupled] = 0.0
        return Preconditioning(change.matrix.copy(), change, motions)

    def change(self, held: Ints) -> Change:
        """Return v for the present geometry, contacts and tangent; collective."""
        T = self.system.transformation
        eliminated = eliminated_dofs(self.system, self.supports)
        decoupled = np.union1d(eliminated, held).astype(np.int32)
        C, E = (None, None) if T is None else T.uncouple(decoupled)
        self.operator.follow(C, decoupled)
        return Change(E, self.operator.matrix)


def eliminated_dofs(system: InterfaceSystem, supports: Dirichlet) -> Ints:
    """Return the owned unknowns of y that Dirichlet data and ties leave no freedom."""
    d = supports.V.dofmap.index_map_bs
    node, component = np.nonzero(supports.owned)
    parts = [d * node + system.slots()[node, component]]
    for link in system.links:
        k, axis = np.nonzero(link.equal)
        parts.append(d * link.nodes[k] + axis)
    return np.unique(np.concatenate(parts)).astype(np.int32)
