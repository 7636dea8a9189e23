# SPDX-License-Identifier: MIT
"""Frictionless unilateral contact."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.frames import create_frames
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.results import Result

# A slave normal that loses more than this share of its length to Dirichlet data has no direction
# left in which contact could act.
MIN_FREE_NORMAL = 0.5


class Contact(Interface):
    """Frictionless unilateral contact: w_n <= gap, pressure >= 0, pressure * opening = 0.

    ``pressure`` (traction, >= 0 in compression), ``gap`` (>= 0 when open; not-a-number at slave
    nodes that face no master) and ``active`` (1 in contact, else 0) are Functions that vanish off
    the slave side. ``force`` is the resultant exerted on the slave side, -sum_j D_jj lambda_j n_j.
    """

    kind = "contact"
    multiplier: Any = Result()  # (n,) lambda_j at the owned slave nodes

    def _allowed(self, nodes: Ints, left: Floats) -> Bools:
        return np.asarray((left >= MIN_FREE_NORMAL)[:, None])

    def _set_frames(self, P: Floats, normals: Floats) -> None:
        kept, p = self.kept[:, 0], self.pattern
        fixed = self.fixed[p.nodes]
        frames, slots = create_frames(np.where(kept[:, None], normals, np.eye(self.d)[0]), fixed)
        self.normals = np.where(kept[:, None], normals, 0.0)
        self.R = np.where(kept[:, None, None], frames, np.eye(self.d))
        self._slots = slots
        self.restrict(self.near)
        n = self.normals[p.row]
        self._fill(P[:, 0, None, None] * n[:, :, None] * n[:, None, :])

    def restrict(self, near: Bools) -> None:
        """Let only these of the kept nodes take part in the change of basis, (n,)."""
        self.near = near
        axes = np.arange(self.d, dtype=np.int32)
        self.S = (self.kept[:, 0] & near)[:, None] & (axes == 0)
        left = np.where(self.fixed[self.pattern.nodes], axes, -1)
        self.slot = np.where(self.S[:, :1], self._slots, left)

    def set_results(self, reaction: Floats, active: Bools, gap: Floats, x: Floats) -> None:
        """Set resultants and Functions; collective.

        Args:
            reaction: (n,) D_jj lambda_j >= 0 at the owned slave nodes.
            active: (n,) nodes in contact.
            gap: (n,) nodal gaps w_n may still close.
            x: (owned nodes, d) coordinates for the moments.
        """
        kept = self.kept[:, 0]
        self.set_resultants(reaction[:, None] * self.normals, x)
        self.multiplier = np.divide(
            reaction, self.weight[:, 0], out=np.zeros_like(reaction), where=kept
        )
        on_slave = self.slave_nodes
        for function, values in ((self.pressure, self.multiplier), (self.gap, gap)):
            function.x.array[:] = np.where(on_slave, self._extend(values, kept), 0.0)
        self.pressure.x.array[:] = np.nan_to_num(self.pressure.x.array)
        self.active.x.array[:] = 0.0
        self.active.x.array[self.pattern.nodes] = active
        self.active.x.scatter_forward()
