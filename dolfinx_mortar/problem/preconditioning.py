# SPDX-License-Identifier: MIT
"""Multigrid matrix: the tangent in unknowns uncoupled across open contacts."""

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.qp import Change, Preconditioning
from dolfinx_mortar.supports.bodies import Bodies, Motion, free_motions, rigid_motions
from dolfinx_mortar.supports.dirichlet import Dirichlet


class UnknownsOfBodies:
    """Unknowns of multigrid: those of the QP, but displacements at open contacts.

    Rigid motions of the whole, the near-null space, have w_n = 0 at closed nodes only; at open ones
    the change of basis is reversed (`Transformation.uncouple`).
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
        """Matrix and near-null space; collective.

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
        """Body (n,) of each owned unknown, one for ties, and for all if one is free; collective."""
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
    """Owned unknowns of y prescribed by Dirichlet data or ties."""
    d = supports.V.dofmap.index_map_bs
    node, component = np.nonzero(supports.owned)
    parts = [d * node + system.slots()[node, component]]
    for link in system.links:
        k, axis = np.nonzero(link.equal)
        parts.append(d * link.nodes[k] + axis)
    return np.unique(np.concatenate(parts)).astype(np.int32)
