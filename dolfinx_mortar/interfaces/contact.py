# SPDX-License-Identifier: MIT
"""Frictionless unilateral contact."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.constraints import Constraints
from dolfinx_mortar.interfaces.frames import create_frames
from dolfinx_mortar.interfaces.interface import Frame, Interface

# A slave normal that loses more than this share of its length to Dirichlet data has no direction
# left in which contact could act.
MIN_FREE_NORMAL = 0.5


class Contact(Interface):
    """Frictionless unilateral contact: w_n <= gap, pressure >= 0, pressure * opening = 0.

    ``pressure`` (traction, >= 0 in compression), ``gap`` (>= 0 when open; not-a-number at slave
    nodes that face no master) and ``active`` (1 in contact, else 0) are Functions that vanish off
    the slave side. ``force`` is the resultant exerted on the slave side, -sum_j D_jj lambda_j n_j.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag of the side that carries the multipliers.
        master: tag of the other side.
        surface: "smooth" measures the gap between the smooth surfaces through the nodes of the
            facets, g_j - sum_q w Phi_j (h_s + h_m) / D_jj with the heights h of
            `dolfinx_mortar.geometry.smooth`; "facets" between the facets, as the paper does. D, M
            and N are the same.
        feature_angle: degrees between two facets from which on they meet in an edge, which stays
            one; for smooth surfaces.

    Raises:
        ValueError: for tags that are none, and an unknown surface or angle.
    """

    one_sided = True

    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Return (n, 1): nodes whose normal is not taken by Dirichlet data."""
        return np.asarray((left >= MIN_FREE_NORMAL)[:, None])

    def frame(self, normals: Floats, kept: Bools, fixed: Bools) -> Frame:
        """Return frames with the normal first, which is constrained; Cartesian where not kept."""
        n, d = normals.shape
        some = kept[:, 0]
        R, axes = np.tile(np.eye(d), (n, 1, 1)), np.arange(d, dtype=np.int32)
        slot = np.where(fixed, axes, -1).astype(np.int32)
        R[some], slot[some] = create_frames(normals[some], fixed[some])
        on = some[:, None]
        return Frame(R, slot, on & (axes == 0), np.where(on, normals, 0.0))

    def blocks(self, P: Floats, normals: Floats) -> Floats:
        """Return P_jl n_j n_j^T."""
        return np.asarray(P[:, 0, None, None] * normals[:, :, None] * normals[:, None, :])

    def measured(self, x: PETSc.Vec, u: PETSc.Vec) -> PETSc.Vec:
        """Return the positions."""
        return x

    def constraints(self, nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
        """Return w_n <= gap, the gap being minus the relative position along the normal."""
        on = directions[:, 0]
        gap = -slip[on, 0]
        dofs = (directions.shape[1] * nodes[on]).astype(np.int32)
        return Constraints(dofs, np.full(len(gap), -np.inf), gap, D[on, 0])
