# SPDX-License-Identifier: MIT
"""Mesh tying."""

from __future__ import annotations

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.interface import Interface


class Tie(Interface):
    """Mesh tying ("glue"): both sides move together in all directions, u_s = P u_m.

    Always at X, as in the paper: tied sides keep the partners that they had at the start.
    Directions with Dirichlet data are left to those data. ``force`` is the resultant exerted on the
    slave side; ``pressure`` the normal traction, positive in compression.
    """

    kind = "tie"

    def configuration(self, u: fem.Function | None) -> None:
        """Return None: D and M do not follow the deformation."""
        return None

    def _allowed(self, nodes: Ints, left: Floats) -> Bools:
        return ~self.fixed[nodes]

    def _set_frames(self, P: Floats, normals: Floats) -> None:
        p = self.pattern
        n = len(p.nodes)
        self.normals = normals
        self.R = np.broadcast_to(np.eye(self.d), (n, self.d, self.d))
        axes = np.arange(self.d, dtype=np.int32)
        self.slot = np.where(self.fixed[p.nodes], axes, -1)
        self.S = self.kept
        self._fill(P[:, :, None] * np.eye(self.d))

    def set_results(self, reaction: Floats, x: Floats) -> None:
        """Set resultants and the normal traction from the tying forces (n, d); collective."""
        self.set_resultants(reaction, x)
        kept = self.kept.any(axis=1)
        weight = np.maximum(self.weight.max(axis=1), np.finfo(float).tiny)
        normal = np.einsum("ni,ni->n", reaction, self.normals) / weight
        pressure = np.nan_to_num(self._extend(np.where(kept, normal, 0.0), kept))
        self.pressure.x.array[:] = np.where(self.slave_nodes, pressure, 0.0)
        self.active.x.array[:] = 0.0
        self.active.x.array[self.pattern.nodes] = kept
        self.active.x.scatter_forward()
