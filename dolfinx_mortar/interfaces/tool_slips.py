# SPDX-License-Identifier: MIT
"""Slip along a rigid tool that moves: x_j less where its place on the tool has gone.

A node is on the tool at the point nearest to it at the last commit. That point moves with the tool;
what the node does beside it is its motion, of which the tangential part is the slip. Where node and
tool move alike there is none, whatever the motion. On frozen surfaces it is the displacement since
less that of the tool at X.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.coupling import CoupledSides
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import Pose, Tool


@dataclass(frozen=True)
class ToolPartners(Partners):
    """Partners on a tool: P is zero, and the motion that of the node less that of its place."""

    at: Floats  # (n, d) where the nodes were, X on frozen surfaces
    place: Floats  # (n, d) the points of the tool on which they were, as it starts
    tool: Tool

    @classmethod
    def create(
        cls, link: CoupledSides, x: PETSc.Vec, tool: Tool, began: Pose, *, frozen: bool
    ) -> ToolPartners:
        """Return the partners of a link; collective.

        Args:
            x: (n,) positions at the last commit.
            tool: which may move in the step.
            began: where it was at the last commit.
            frozen: whether the surfaces stay at X.
        """
        n, scalars = link.coupling.normals, link.pattern.scalars
        scalars.fill(np.zeros((len(link.coupling.P), 1, 1)))
        if frozen:
            at = link.sides.slave.X[: link.sides.slave.owned]
            place = began.to_tool(at)
        else:
            at = x.array_r.reshape(-1, n.shape[1])[link.nodes]
            place = began.to_tool(at)
            with raised_together(link.sides.V.mesh.comm):
                found = tool.shape.distance(place)
            place = place - found.value[:, None] * found.gradient
        known = np.ones(len(n), dtype=bool)
        whole = scalars.matrix.copy(), known, n, np.zeros(len(n)), 0.0 * n
        return cls(*whole, at=at, place=place, tool=tool)

    def motion(self, link: CoupledSides, moved: PETSc.Vec) -> Floats:
        """Return the motion (n, d) for the displacement since the last commit."""
        there = self.at + moved.array_r.reshape(-1, self.at.shape[1])[link.nodes]
        return np.asarray(there - self.tool.pose().to_space(self.place))

    def motion_by_normals(self, link: CoupledSides) -> Floats:
        """Return 0: the motion does not depend on normals."""
        n, d = self.at.shape
        return np.zeros((n, d, d))
