# SPDX-License-Identifier: MIT
"""An interface in one configuration: its constraints, the nodes they act on, its results."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.interfaces.coupling import CoupledSides
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.mortar.surface import accumulate


@dataclass(frozen=True)
class Link(CoupledSides):
    """An interface with what a search and an update have found for it."""

    interface: Interface

    @property
    def equal(self) -> Bools:
        """Constrained directions (n, d) held by equalities: all, or none if the link can open."""
        return self.constrained & (not self.interface.unilateral)

    @property
    def prescribed(self) -> Bools:
        """Slave nodes (n,) that face the master without a multiplier, because of Dirichlet data."""
        kept, coverage = self.coupling.kept.any(axis=1), self.coupling.coverage
        left_out = coverage.faces & ~kept & ~coverage.weightless
        return np.asarray(left_out & self.sides.fixed[self.nodes].any(axis=1))

    def prescribed_facets(self) -> Bools:
        """Return the slave facets (m,) of this rank with such nodes alone; collective."""
        slave = self.sides.slave
        marks = np.zeros(len(slave.nodes))
        marks[: slave.owned] = self.prescribed
        return np.asarray((accumulate(slave, marks) > 0)[slave.facets].all(axis=1))

    def held_motion(self, v: PETSc.Vec) -> Floats:
        """Return the constrained motion that is resisted both ways, see `equal`; collective."""
        held = self.coupling.directions & (not self.interface.unilateral)
        return np.asarray(self.relative(v)[held])

    def acting(self, closed: Bools) -> Bools:
        """Return the slave nodes (n,) at which the interface acts.

        Args:
            closed: (owned nodes,) nodes whose contact is closed.
        """
        some = self.constrained.any(axis=1)
        if self.interface.unilateral:
            return np.asarray(closed[self.nodes] & some)
        return np.asarray(self.coupling.kept.any(axis=1))

    def apart(self, v: PETSc.Vec, jump: PETSc.Vec | None) -> PETSc.Vec:
        """Return a displacement v (n,) less the jump (n,), None for none, and the tightening."""
        found, way, sides = v if jump is None else v - jump, self.interface.tightening, self.sides
        if way is None or not way.any():
            return found
        alone = ~(sides.on_slave & sides.on_master)[self.nodes]
        return found - self.spread(way * alone[:, None])

    def spread(self, way: Floats) -> PETSc.Vec:
        """Return a motion (n, d) of the slave nodes as a displacement, 0 at others."""
        v = self.Q.createVecRight()
        v.array.reshape(-1, way.shape[1])[self.nodes] = way
        return v

    def shown_gap(self, gap: Floats, jump: PETSc.Vec | None) -> Floats:
        """Return the gap (n,) that results show: how far a jump opens what cannot open itself.

        Args:
            gap: (owned nodes,) of what can open.
            jump: as for `apart`.
        """
        normals = self.coupling.normals
        if self.interface.unilateral:
            return np.asarray(gap[self.nodes])
        still = self.spread(0.0 * normals)
        values = self.apart(still, jump).array_r.reshape(-1, normals.shape[1])[self.nodes]
        return np.asarray((values * normals).sum(axis=1))
