# SPDX-License-Identifier: MIT
r"""Derivatives of the forces and weighted gaps of contact with a rigid tool.

On a facet, with w = w_q J the weights of its points, N the functions of its nodes and N~ those that
the dual ones are biorthogonal to (see `mortar.duals`), over the nodes that carry a multiplier

    Phi = B N~ + 1/k,  B = (I - 1 1^T / k) A,  A = diag(d) m^-1,  d = sum w N~,  m = sum w N~ N~^T.

Its points move with the nodes, dx = N_m dx_m, and dJ = J grad N_m . dx_m. So

    g_j = sum w Phi_j phi,    dg_j = sum w [dB N~ phi + Phi_j (phi dJ/J + grad phi . dx)]_j,
    D_jl = sum w Phi_j N_l,   dD_jl = sum w [dB N~ + Phi dJ/J]_j N_l,   F_l = sum_j t_j D_jl,
    dA = (diag(dd) - A dm) m^-1,

and the tractions t_j = lambda_j n_j + tau_j turn with n_j, dn_j = -(I - n n^T) Hess phi dx_j, and
their tangents as in `moving_geometry`.
For phi stands what `point_gaps` has there. Of distances of nodes, sum N_m phi_m, the last term has
N_m grad phi_m for grad phi N_m; the change of heights of second order by the strain of the bodies
along the normal is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from scipy import sparse

from dolfinx import fem
from dolfinx_mortar.algebra.block_sums import BlockEntries, Blocks, BlockSums
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.geometry.facets import surface_gradients
from dolfinx_mortar.interfaces.contact_derivatives import (
    LinkDerivatives,
    SlipRows,
    facets_near,
    incidence,
    layout_of,
)
from dolfinx_mortar.interfaces.coupling import CoupledSides
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import SidePattern, Tool, find_facing, point_gaps
from dolfinx_mortar.interfaces.tool_slips import ToolPartners
from dolfinx_mortar.mortar.duals import Duals, find_duals
from dolfinx_mortar.mortar.operators import in_D
from dolfinx_mortar.mortar.surface import accumulate, coordinates, facets_at
from dolfinx_mortar.mortar.whole_side import WholeSide, rule_of, whole_facets


@dataclass(frozen=True)
class _OnFacets:
    """Values at the points of whole facets."""

    which: Longs  # (f,) the facets
    duals: Duals  # of these
    w: Floats  # (f, q)
    N: Floats  # (q, k)
    gradients: Floats  # (f, q, k, d) of the functions, along the surface
    phi: Floats  # (f, q)
    by_x: Floats  # (f, q, k, d) of phi by the places of the nodes


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
        slave = link.sides.slave
        at, x = self._at_points(link, u)
        traction, turned = self._tractions(link, x, multipliers, tangential)
        dD, dg, D = _differentiate(at, in_D(slave.element))
        nodes = slave.facets[at.which]
        t, dt = traction[nodes], turned[nodes]
        forces = np.einsum("fji,fjlmc->flimc", t, dD)
        forces += np.einsum("fjl,fjic->flijc", D, dt)
        known = np.ones(slave.owned, dtype=bool)
        F = self.F.fill([Blocks(nodes, nodes, forces)])
        return F, self.G.fill([Blocks(nodes, nodes, dg[:, :, None])]), known

    def slips(
        self, link: CoupledSides, u: fem.Function, partners: Partners, since: PETSc.Vec
    ) -> SlipRows:
        """Return the rows of slips; collective."""
        slave, own = link.sides.slave, slice(None, link.sides.slave.owned)
        x = coordinates(slave, u)
        assert isinstance(partners, ToolPartners)
        by_x, by_n = partners.derivatives(link, since)
        along = (partners.motion(link, since) * link.coupling.R[:, :, 0]).sum(axis=1)
        by_n -= along[:, None, None] * np.eye(by_n.shape[1])
        tangents = link.coupling.rows[:, 1:]
        turned = np.zeros((len(slave.nodes), *by_n.shape[1:]))
        turned[own] = self._turning(link, x)
        alone = np.arange(len(turned))[:, None]
        N = self.N.fill([Blocks(alone, alone, turned[:, None, :, None])])
        return SlipRows(link, partners, tangents @ by_n, N, tangents @ by_x)

    def _turning(self, link: CoupledSides, x: Floats) -> Floats:
        """Return dn_j/dx_j (n, d, d) of the owned slave nodes, 0 where not kept."""
        own = slice(None, link.sides.slave.owned)
        kept, n = link.coupling.kept[:, 0], link.coupling.normals
        found = self.tool.pose().distance(self.tool.asked, x[own])
        size = np.linalg.norm(found.gradient, axis=1)
        across = np.eye(n.shape[1]) - n[:, :, None] * n[:, None, :]
        across /= np.where(kept & (size > 0.0), size, 1.0)[:, None, None]
        across[~kept] = 0.0
        return -across @ found.hessian

    def _tractions(
        self, link: CoupledSides, x: Floats, multipliers: Floats, tangential: Floats | None
    ) -> tuple[Floats, Floats]:
        """Return t_j (n, d) and dt_j/dx_j (n, d, d) at the local slave nodes; collective."""
        slave, own, d = link.sides.slave, slice(None, link.sides.slave.owned), x.shape[1]
        nodes, kept = link.nodes, link.coupling.kept
        n = np.where(kept, link.coupling.normals, 0.0)
        turning = self._turning(link, x)
        pressing = multipliers[nodes, None] * kept
        traction, turned = pressing * n, pressing[:, :, None] * turning
        if tangential is not None:
            along = tangential[nodes] - (tangential[nodes] * n).sum(axis=1)[:, None] * n
            along *= kept
            traction = traction + along
            turned = turned - link.coupling.R[:, :, :1] * (along[:, None] @ turning)
        columns = np.zeros((len(slave.nodes), d + d * d))
        columns[own] = np.concatenate([traction, turned.reshape(-1, d * d)], axis=1)
        summed = accumulate(slave, columns)
        return summed[:, :d], summed[:, d:].reshape(-1, d, d)

    def _at_points(self, link: CoupledSides, u: fem.Function) -> tuple[_OnFacets, Floats]:
        """Return values at the points of the facets that face the tool, and the nodes' places."""
        slave, side = link.sides.slave, self.side
        x, pose, shape = coordinates(slave, u), self.tool.pose(), self.tool.asked
        reached = np.zeros(len(slave.nodes))
        reached[: slave.owned] = link.coupling.kept[:, 0]
        keep = accumulate(slave, reached) > 0.0
        facing = self.asked & find_facing(side, pose, shape, x)
        segments, points = whole_facets(side, x, facing)
        duals = find_duals(side, segments, keep)
        xi, _ = rule_of(slave.element)
        gradients, _ = surface_gradients(facets_at(slave, x), segments.slave, segments.xi_s)
        assert isinstance(link.pattern, SidePattern)
        phi, found = point_gaps(link.pattern, pose, shape, u, segments, points)
        which, q = np.flatnonzero(facing), len(xi)
        k, d = slave.element.nodes, x.shape[1]
        w = segments.weight.reshape(-1, q)
        N = slave.element.shape_functions(segments.xi_s)
        slope = found.gradient[:, None]
        if link.pattern.nodal:
            slope = found.gradient[slave.facets[segments.slave]]
        at = _OnFacets(
            which=which,
            duals=duals.of(which),
            w=w,
            N=slave.element.shape_functions(xi),
            gradients=gradients.reshape(-1, q, k, d),
            phi=phi.reshape(-1, q),
            by_x=(N[:, :, None] * slope).reshape(-1, q, k, d),
        )
        return at, x


def _differentiate(at: _OnFacets, diagonal: Bools) -> tuple[Floats, Floats, Floats]:
    """Return dD_jl/dx_mc (f, k, k, k, d), dg_j/dx_mc (f, k, k, d), and D_jl (f, k, k)."""
    duals, shape = at.duals, (*at.w.shape, at.N.shape[1])
    N_t, Phi = duals.N.reshape(shape), duals.Phi.reshape(shape)
    w_grad = at.w[:, :, None, None] * at.gradients  # of J
    dd = np.einsum("fqmc,fqa->famc", w_grad, N_t)
    dm = np.einsum("fqmc,fqa,fqb->fabmc", w_grad, N_t, N_t)
    dA = np.einsum("fjmc,fji->fjimc", dd, duals.inverse)
    dA -= np.einsum("fja,fabmc,fbi->fjimc", duals.A, dm, duals.inverse)
    dB = duals.share_out(dA)
    mass = np.einsum("fq,fqi,ql->fil", at.w, N_t, at.N)
    dD = np.einsum("fjimc,fil->fjlmc", dB, mass)
    dD += np.einsum("fqmc,fqj,ql->fjlmc", w_grad, Phi, at.N)
    D = np.einsum("fq,fqj,ql->fjl", at.w, Phi, at.N)
    zero = duals.kept[:, :, None] & duals.kept[:, None] & ~diagonal
    D[zero], dD[zero] = 0.0, 0.0
    heights = np.einsum("fq,fqi,fq->fi", at.w, N_t, at.phi)
    dg = np.einsum("fjimc,fi->fjmc", dB, heights)
    dg += np.einsum("fqmc,fqj,fq->fjmc", w_grad, Phi, at.phi)
    dg += np.einsum("fq,fqj,fqmc->fjmc", at.w, Phi, at.by_x)
    return dD, dg, D
