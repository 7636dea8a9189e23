# SPDX-License-Identifier: MIT
"""Multigrid matrix: the tangent in unknowns uncoupled across open contacts."""

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.common.arrays import Ints
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.qp import Change
from dolfinx_mortar.solid.supports import Bodies, Dirichlet, rigid_motions


class UnknownsOfBodies:
    """Unknowns of multigrid: those of the QP, except displacements at open contacts.

    Rigid motions, the near-null space, have w_n = 0 at closed nodes only.
    """

    def __init__(
        self,
        operator: CongruentOperator,
        system: InterfaceSystem,
        supports: Dirichlet,
        bodies: Bodies,
    ) -> None:
        self.system, self.supports, self.bodies = system, supports, bodies
        self.operator = CongruentOperator(operator.K, operator.half)

    def change(self, held: Ints) -> Change:
        """See `Unknowns`; collective."""
        T = self.system.transformation
        # prescribed by Dirichlet data or ties
        d, (node, component) = self.bodies.V.dofmap.index_map_bs, self.supports.owned.nonzero()
        parts = [held, d * node + self.system.slots()[node, component]]
        for link in self.system.links:
            if not link.unilateral:
                k, axis = np.nonzero(link.constrained)
                parts.append(d * link.nodes[k] + axis)
        decoupled = np.unique(np.concatenate(parts)).astype(np.int32)
        C, E = (None, None) if T is None else T.uncouple(decoupled)
        self.operator.follow(C, decoupled)
        return Change(E, self.operator.matrix)

    def motions(self, change: Change) -> list[PETSc.Vec]:
        """See `Unknowns`; collective."""
        T, motions = self.system.transformation, rigid_motions(self.bodies)
        if T is not None:
            motions = [T.uncoupled(motion, change.E) for motion in motions]
        for motion in motions:
            motion.array[self.operator.decoupled] = 0.0
        return motions
