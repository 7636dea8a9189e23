# SPDX-License-Identifier: MIT
"""Mesh tying."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.constraints import Constraints, equalities
from dolfinx_mortar.interfaces.interface import Frame, Interface


class Tie(Interface):
    """Mesh tying ("glue"): both sides move together in all directions.

    Always at X, as in the paper: tied sides keep the partners that they had at the start.
    Directions with Dirichlet data are left to those data. ``force`` is the resultant exerted on the
    slave side; ``pressure`` the normal traction, positive in compression.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag of the side that carries the multipliers.
        master: tag of the other side.
        surface: "facets" ties points of facets, u_s = P u_m as in the paper; "smooth" the surfaces
            for which they stand: where facets are apart, u_s = P u_m + (motion of the arm between
            them), see `dolfinx_mortar.geometry.arms`. D and M are the same.
        feature_angle: degrees between two facets from which on they meet in an edge, which stays
            one; for smooth surfaces.

    Raises:
        ValueError: for tags that are none, and an unknown surface or angle.
    """

    def configuration(self, u: fem.Function | None) -> None:
        """Return None: D and M do not follow the deformation."""
        return None

    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Return (n, d): directions without Dirichlet data."""
        return ~fixed

    def frame(self, normals: Floats, kept: Bools, fixed: Bools) -> Frame:
        """Return Cartesian frames, of which the kept directions are constrained."""
        n, d = normals.shape
        slot = np.where(fixed, np.arange(d, dtype=np.int32), -1).astype(np.int32)
        return Frame(np.broadcast_to(np.eye(d), (n, d, d)), slot, kept, normals)

    def blocks(self, P: Floats, normals: Floats) -> Floats:
        """Return P_jl I."""
        return np.asarray(P[:, :, None] * np.eye(P.shape[1]))

    def measured(self, x: PETSc.Vec, u: PETSc.Vec) -> PETSc.Vec:
        """Return the displacements: the initial distance stays."""
        return u

    def constraints(self, nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
        """Return w = 0: what has slipped is taken back."""
        node, axis = np.nonzero(directions)
        dofs = (directions.shape[1] * nodes[node] + axis).astype(np.int32)
        return equalities(dofs, -slip[node, axis], D[node, axis])
