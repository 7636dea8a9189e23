# SPDX-License-Identifier: MIT
"""The exact tangent of contact with a rigid tool: its product rule is in `mortar.tangent`.

The tractions t_j = lambda_j n_j + tau_j turn with n_j, dn_j = -(I - n n^T) Hess phi dx_j, and their
tangents as in `moving_geometry`. For phi stands what `point_gaps` has there: of distances of nodes
their interpolation. The change of heights of second order by the strain of the bodies along the
normal is left out, and that of arcs in the plane by the length of their chords.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from scipy import sparse

from dolfinx import fem
from dolfinx_mortar.algebra.block_sums import BlockEntries, Blocks, BlockSums
from dolfinx_mortar.arrays import TINY, Bools, Floats
from dolfinx_mortar.geometry.facets import scaled_normals
from dolfinx_mortar.interfaces.contact_tangent import (
    LinkDerivatives,
    SlipRows,
    facets_near,
    incidence,
    layout_of,
    tractions_of,
)
from dolfinx_mortar.interfaces.coupling import CoupledSides
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import SidePattern, Tool, find_facing, point_gaps
from dolfinx_mortar.interfaces.tool_slips import ToolPartners
from dolfinx_mortar.mortar.duals import find_duals
from dolfinx_mortar.mortar.surface import coordinates, facets_at
from dolfinx_mortar.mortar.tangent import differentiate_whole
from dolfinx_mortar.mortar.whole_side import WholeSide, rule_of, whole_facets
from dolfinx_mortar.shapes.shape import unit_vectors


class ToolDerivatives(LinkDerivatives):
    """Derivatives for all facets of a side that are near the tool."""

    def __init__(self, link: CoupledSides, side: WholeSide, tool: Tool) -> None:
        """Make the patterns; collective."""
        V, slave = link.sides.V, link.sides.slave
        self.side, self.tool = side, tool
        self.asked = facets_near(link)
        facets = np.flatnonzero(self.asked).astype(np.int32)
        n, d = len(slave.nodes), V.dofmap.index_map_bs
        among = incidence(facets, slave.facets[facets], (len(self.asked), n))
        nodes = V.dofmap.index_map.local_to_global(slave.nodes).astype(np.int64)
        dofs = (d * nodes[:, None] + np.arange(d)).ravel()
        pattern = among.T @ among
        of = V.mesh.comm, layout_of(V)
        alone = sparse.eye_array(n, format="csr")
        self.F = BlockSums(*of, BlockEntries(pattern, (d, d), dofs, dofs))
        self.G = BlockSums(*of, BlockEntries(pattern, (1, d), d * nodes, dofs))
        self.N = BlockSums(*of, BlockEntries(alone, (d, d), dofs, dofs))

    def serves(self, link: CoupledSides) -> bool:
        """Return True: the pattern is that of the nodes in T, with which these are made."""
        return True

    def differentiate(
        self, link: CoupledSides, u: fem.Function, multipliers: Floats, tangential: Floats | None
    ) -> tuple[PETSc.Mat, PETSc.Mat, Bools]:
        """Return those of forces, and of gaps in the rows w_n, and which of these; collective."""
        slave, side, x = link.sides.slave, self.side, coordinates(link.sides.slave, u)
        pose, shape, d = self.tool.pose(), self.tool.asked, x.shape[1]
        given, keep = tractions_of(link, multipliers, tangential)
        facing = self.asked & find_facing(side, pose, shape, x)
        segments, points = whole_facets(side, x, facing)
        assert isinstance(link.pattern, SidePattern)
        phi, found = point_gaps(link.pattern, pose, shape, u, segments, points)
        which, facets = np.flatnonzero(facing), facets_at(slave, x)[facing]
        nodes, k = slave.facets[which], slave.element.nodes
        slope = found.gradient[:, None]
        if link.pattern.nodal:
            slope = found.gradient[slave.facets[segments.slave]]
        by_x = slave.element.shape_functions(segments.xi_s)[:, :, None] * slope
        xi, _ = rule_of(slave.element)
        per_point = slave.element.size * segments.weight.reshape(-1, len(xi))
        per_point /= np.linalg.norm(scaled_normals(facets, xi), axis=2)
        duals = find_duals(side, segments, keep).of(which)
        at = per_point, phi.reshape(per_point.shape), by_x.reshape(*per_point.shape, k, d)
        forces, gaps, D = differentiate_whole(facets, xi, *at, duals, given.tractions[nodes])
        forces += np.einsum("fjl,fjic->flijc", D, (given.changes @ self._turning(x))[nodes])
        known = np.ones(slave.owned, dtype=bool)
        F = self.F.fill([Blocks(nodes, nodes, forces)])
        return F, self.G.fill([Blocks(nodes, nodes, gaps[:, :, None])]), known

    def slips(
        self, link: CoupledSides, u: fem.Function, partners: Partners, since: PETSc.Vec
    ) -> SlipRows:
        """Return the rows of slips; collective."""
        slave, x = link.sides.slave, coordinates(link.sides.slave, u)
        assert isinstance(partners, ToolPartners)
        by_x, by_n = partners.derivatives(link, since)
        along = (partners.motion(link, since) * link.coupling.R[:, :, 0]).sum(axis=1)
        by_n -= along[:, None, None] * np.eye(by_n.shape[1])
        tangents = link.coupling.rows[:, 1:]
        turned = self._turning(x)
        turned[slave.owned :] = 0.0
        alone = np.arange(len(turned))[:, None]
        N = self.N.fill([Blocks(alone, alone, turned[:, None, :, None])])
        return SlipRows(link, partners, tangents @ by_n, N, tangents @ by_x)

    def _turning(self, x: Floats) -> Floats:
        """Return dn_j/dx_j (n, d, d) of nodes at x (n, d), n being -grad phi / |grad phi|."""
        found = self.tool.pose().distance(self.tool.asked, x)
        size, g = unit_vectors(found.gradient)
        across = np.eye(x.shape[1]) - g[:, :, None] * g[:, None]
        return np.asarray(-across @ found.hessian / np.maximum(size, TINY)[:, None, None])
