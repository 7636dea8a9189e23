# SPDX-License-Identifier: MIT
"""The matrix of multigrid: the tangent in unknowns without coupling across open contacts."""

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.qp import Change, Preconditioning
from dolfinx_mortar.supports.bodies import Bodies, Motion, free_motions, rigid_motions
from dolfinx_mortar.supports.dirichlet import Dirichlet


class UnknownsOfBodies:
    """The unknowns of multigrid: those of the QP, but displacements where contact is open.

    The near-null space are the rigid motions of the whole. In the unknowns of the QP they have
    w_n = 0 at all covered slave nodes, which is right only where contact is closed; elsewhere the
    change of basis is reversed (`Transformation.uncouple`).

    Args:
        operator: that of the QP, with the tangent K.
        system: the interfaces, with T up to date.
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

    def preconditioning(self, held: Ints) -> Preconditioning:
        """Return the matrix and near-null space of a set-up; collective.

        Args:
            held: owned unknowns of y at their bounds.
        """
        T, change = self.system.transformation, self.change(held)
        motions = rigid_motions(self.bodies)
        if T is not None:
            motions = [T.uncoupled(motion, change.E) for motion in motions]
        for motion in motions:
            motion.array[self.operator.decoupled] = 0.0
        B, between = self.operator.split(self._parts())
        return Preconditioning(B, change, motions, between)

    def _parts(self) -> Ints:
        """Return the body (n,) of each owned unknown, where tied bodies are one; collective.

        All are one where contact alone holds a body: by itself its matrix is singular.
        """
        label, group = self.bodies.label, self.bodies.group
        ties = (link for link in self.system.links if not link.unilateral)
        held: list[Motion] = [link.constrained_motion for link in ties]
        held.append(lambda v: v.array_r[self.supports.owned.ravel()])
        if free_motions(self.bodies, held):
            label, group = np.zeros_like(label), None
        return np.repeat(
            label if group is None else group[label], self.supports.V.dofmap.index_map_bs
        )

    def change(self, held: Ints) -> Change:
        """Return v for the present geometry, contacts and tangent; collective."""
        T = self.system.transformation
        eliminated = eliminated_dofs(self.system, self.supports)
        decoupled = np.union1d(eliminated, held).astype(np.int32)
        C, E = (None, None) if T is None else T.uncouple(decoupled)
        self.operator.follow(C, decoupled)
        return Change(E, self.operator.matrix)


def eliminated_dofs(system: InterfaceSystem, supports: Dirichlet) -> Ints:
    """Return the owned unknowns of y that Dirichlet data or ties prescribe."""
    d = supports.V.dofmap.index_map_bs
    node, component = np.nonzero(supports.owned)
    parts = [d * node + system.slots()[node, component]]
    for link in system.links:
        k, axis = np.nonzero(link.equal)
        parts.append(d * link.nodes[k] + axis)
    return np.unique(np.concatenate(parts)).astype(np.int32)
