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
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import Pose
from dolfinx_mortar.shapes import Shape


@dataclass(frozen=True)
class ToolPartners(Partners):
    """Partners on a tool: P is zero, and the motion that of the node less that of its place."""

    offset: Floats  # (n, d) the motion that a node has without moving itself

    @classmethod
    def create(
        cls, link: Link, x: PETSc.Vec, shape: Shape, began: Pose, now: Pose, *, frozen: bool
    ) -> ToolPartners:
        """Return the partners of a link; collective.

        Args:
            link: the obstacle.
            x: (n,) positions at the last commit.
            shape: of the tool.
            began: where the tool was then.
            now: where it is in the step.
            frozen: whether the surfaces stay at X.
        """
        coupling, scalars = link.coupling, link.pattern.scalars
        scalars.fill(np.zeros((len(coupling.P), 1, 1)))
        d, own = coupling.normals.shape[1], slice(None, link.sides.slave.owned)
        if frozen:
            X = link.sides.slave.X[own]
            offset = X - now.to_space(began.to_tool(X))
        else:
            at = x.array_r.reshape(-1, d)[link.nodes]
            xi = began.to_tool(at)
            with raised_together(link.sides.V.mesh.comm):
                found = shape.distance(xi)
            offset = at - now.to_space(xi - found.value[:, None] * found.gradient)
        n, zero = coupling.normals, np.zeros(len(offset))
        return cls(
            scalars.matrix.copy(), np.ones(len(n), dtype=bool), n, zero, 0.0 * n, offset=offset
        )

    def motion(self, link: Link, moved: PETSc.Vec) -> Floats:
        """Return the motion (n, d) for the displacement since the last commit."""
        d = self.offset.shape[1]
        return np.asarray(moved.array_r.reshape(-1, d)[link.nodes] + self.offset)

    def motion_by_normals(self, link: Link) -> Floats:
        """Return 0: the motion does not depend on normals."""
        n, d = self.offset.shape
        return np.zeros((n, d, d))
