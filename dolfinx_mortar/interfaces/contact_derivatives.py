# SPDX-License-Identifier: MIT
"""Derivatives of one contact: of its forces, its weighted gaps and its slips by the displacement.

See `moving_geometry` for the system that they belong to.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from scipy import sparse

from dolfinx import fem
from dolfinx_mortar.algebra.block_sums import BlockEntries, Blocks, SumWithProducts
from dolfinx_mortar.algebra.csr import owned_rows
from dolfinx_mortar.algebra.triplets import Triplets
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.interfaces.coupling import CoupledSides, node_motions
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.mortar.curvature_correction import height_slopes
from dolfinx_mortar.mortar.derivatives import Derivatives, Tractions, differentiate
from dolfinx_mortar.mortar.duals import weighted_duals
from dolfinx_mortar.mortar.edge_derivatives import differentiate_edges
from dolfinx_mortar.mortar.edges import edge_normals, find_sharing, open_duals
from dolfinx_mortar.mortar.integrals import some_points
from dolfinx_mortar.mortar.space_derivatives import differentiate_in_space
from dolfinx_mortar.mortar.surface import (
    Surface,
    accumulate,
    coordinates,
    nodal_normals,
    normal_derivatives,
)


@dataclass(frozen=True)
class Unknowns:
    """How the unknowns of a vector space are divided among ranks; see `algebra.blocks.Layout`."""

    size_local: int
    size_global: int


@dataclass(frozen=True)
class SlipRows:
    """Rows of the slips of a contact, s.(du_j - P du) + m.dt + t.dm, m being the motion so far.

    P is that of the partners, see `slip_partners`; the tangents t turn with the averaged normal. s
    is t, but on tools, along whose surface the motion is taken.
    """

    link: CoupledSides
    partners: Partners
    turning: Floats  # (n, d - 1, d) m.dt + t.dm by the averaged normals
    normals: PETSc.Mat  # derivatives of these, on edges of the normals there
    along: Floats  # (n, d - 1, d) s

    @property
    def d(self) -> int:
        """The dimension."""
        return int(self.turning.shape[2])

    @property
    def columns(self) -> int:
        """How many unknowns there are."""
        return int(self.normals.getSize()[1])

    def of(self, du: PETSc.Vec) -> Floats:
        """Return the slips (n, d - 1) that du adds, 0 without partners; collective."""
        motion = node_motions(self.link, self.partners.P, du)
        turned = (self.normals * du).array_r.reshape(-1, self.d)[self.link.nodes]
        added = np.einsum("nti,ni->nt", self.along, motion)
        added += np.einsum("nti,ni->nt", self.turning, turned)
        return np.where(self.partners.known[:, None], added, 0.0)

    def rows(self, t: int) -> sparse.csr_array:
        """Return the rows (n, unknowns) of one tangent of the owned slave nodes."""
        nodes, d, tangents = self.link.nodes, self.d, self.along[:, t]
        index_map, n = self.link.sides.V.dofmap.index_map, len(self.link.nodes)
        P = owned_rows(self.partners.P)[nodes].tocoo()
        own = nodes + index_map.local_range[0]
        row = np.concatenate([np.arange(n), P.row])
        column = np.concatenate([own, P.col])
        value = np.concatenate([np.ones(n), -P.data])
        shape = n, self.columns
        parts = [
            sparse.coo_array((value * tangents[row, i], (row, d * column + i)), shape)
            for i in range(d)
        ]
        N = owned_rows(self.normals)
        turned = (sparse.diags_array(self.turning[:, t, i]) @ N[d * nodes + i] for i in range(d))
        return sparse.csr_array(sum([*turned, *parts[1:]], parts[0]))


class LinkDerivatives(ABC):
    """Derivatives of forces, gaps and slips of an interface on a surface that moves."""

    @abstractmethod
    def serves(self, link: CoupledSides) -> bool:
        """Tell whether the pattern is also that of another link; on this rank."""

    @abstractmethod
    def differentiate(
        self, link: CoupledSides, u: fem.Function, multipliers: Floats, tangential: Floats | None
    ) -> tuple[PETSc.Mat, PETSc.Mat, Bools]:
        """Return those of forces, and of gaps in the rows w_n, and which of these; collective.

        Args:
            link: the interface at X + u.
            multipliers: lambda_j (owned nodes,).
            tangential: tangential tractions (owned nodes, d), None without friction.

        Returns:
            d(B^T lambda)/du, dG_j in the rows w_n of its nodes, and nodes (n,) of which these are
            known. The matrices are refilled in the next call.
        """

    @abstractmethod
    def slips(
        self, link: CoupledSides, u: fem.Function, partners: Partners, since: PETSc.Vec
    ) -> SlipRows:
        """Return the rows of slips at the iterate that was differentiated last; collective."""


class ContactDerivatives(LinkDerivatives):
    """Derivatives of the forces and the weighted gaps of one contact.

    They are sums F_x + F_n N + F_c C, N being the derivatives of the averaged normals, C those of
    the normals on edges. On a slave facet forces and gaps depend on all
    of its partners, by the dual functions.
    """

    def __init__(self, link: CoupledSides) -> None:
        """Make the patterns, for all candidates of the slave facets that are near; collective."""
        V, slave, pairing = link.sides.V, link.sides.slave, link.pairing
        assert pairing is not None
        self.asked, self._found = facets_near(link), pairing
        pairs = pairing.pairs[self.asked[pairing.pairs[:, 0]]]
        n, d = len(slave.nodes), V.dofmap.index_map_bs
        facets: Ints = np.flatnonzero(self.asked).astype(np.int32)
        master = pairing.master_facets[pairs[:, 1]]
        on_slave = incidence(facets, slave.facets[facets], (len(self.asked), n))
        shape = len(self.asked), len(pairing.master_nodes)
        on_both = sparse.hstack([on_slave, incidence(pairs[:, 0], master, shape)]).tocsr()
        nodes = V.dofmap.index_map.local_to_global(slave.nodes).astype(np.int64)
        both = np.concatenate([nodes, pairing.master_nodes])
        by_x = (d * both[:, None] + np.arange(d)).ravel()
        by_n, forces, gaps = by_x[: d * n], by_x, d * nodes
        of = V.mesh.comm, layout_of(V)
        at = by_n.reshape(-1, d)[slave.facets]
        block = *at.shape, *at.shape[1:]
        rows = np.broadcast_to(at[:, :, :, None, None], block)
        columns = np.broadcast_to(at[:, None, None], block)
        self.averaged = Triplets(*of, rows, columns)
        N = self.averaged.zero()
        by_forces = [(BlockEntries(on_both.T @ on_slave, (d, d), forces, by_n), N)]
        by_gaps = [(BlockEntries(on_slave.T @ on_slave, (1, d), gaps, by_n), N)]
        self.normals: SumWithProducts | None = None  # of the nodes, with those on edges
        self.edges = link.sides.edges
        if self.edges is not None:
            facets = facets[self.edges[slave.facets[facets]].any(axis=1)]
            at_edges = incidence(facets, slave.facets[facets], (len(self.asked), n))
            own = sparse.hstack([on_slave.T @ on_slave, sparse.csr_array((n, shape[1]))])
            x = BlockEntries(at_edges.T @ on_both + own, (d, d), by_n, by_x)
            y = BlockEntries(at_edges.T @ at_edges, (d, d), by_n, by_n)
            projected = () if _in_space(link) else ((y, N),)  # along averaged normals
            self.normals = SumWithProducts(*of, x, *projected)
            C = self.normals.zero()
            by_forces.append((BlockEntries(on_both.T @ at_edges, (d, d), forces, by_n), C))
            by_gaps.append((BlockEntries(at_edges.T @ at_edges, (1, d), gaps, by_n), C))
        x = BlockEntries(on_both.T @ on_both, (d, d), forces, by_x)
        self.forces = SumWithProducts(*of, x, *by_forces)
        x = BlockEntries(on_slave.T @ on_both, (1, d), gaps, by_x)
        self.gaps = SumWithProducts(*of, x, *by_gaps)

    def serves(self, link: CoupledSides) -> bool:
        """Tell whether a link has the same pairs."""
        new, _ = link.mortar
        names = "pairs", "master_facets", "master_nodes"
        return all(np.array_equal(getattr(self._found, v), getattr(new, v)) for v in names)

    def differentiate(
        self, link: CoupledSides, u: fem.Function, multipliers: Floats, tangential: Floats | None
    ) -> tuple[PETSc.Mat, PETSc.Mat, Bools]:
        """Return those of forces, and of gaps in the rows w_n, and which of these; collective.

        The matrices are refilled. In space rows of gaps are those of facets that carry tractions,
        and of their neighbours: others are open, and cost as much.
        """
        slave, (pairing, operators) = link.sides.slave, link.mortar
        x = coordinates(slave, u)
        given, keep = _tractions(link, self._normals(link, u), multipliers, tangential)
        asked, loaded = self.asked, np.asarray(given.tractions.any(axis=1))
        known: Bools = np.ones_like(loaded)
        if _in_space(link):
            known = _neighbours(slave, loaded)
            asked = asked & known[slave.facets].any(axis=1)
        segments = some_points(operators.segments, asked[operators.segments.slave])
        off_edges = given if self.edges is None else given.held(self.edges)
        found, Phi = self._derivatives(link, u, segments, keep, off_edges)
        blocks = normal_derivatives(slave, x)
        N = self.averaged.fill(blocks)
        by_forces, by_gaps = [(found.F_n, N)], [(found.G_n, N)]
        if self.edges is not None and self.normals is not None:
            at = differentiate_edges(pairing, u, segments, self.edges, Phi, given)
            blocks[self.edges[slave.facets]] = 0.0
            facets = slave.facets[self.asked]
            rest = Blocks(facets, facets, blocks[self.asked])
            projected = () if at.n_n is None else (([at.n_n], N),)
            C = self.normals.fill([rest, at.n_x], *projected)
            by_forces.append(([at.F], C))
            by_gaps.append(([at.G], C))
        F = self.forces.fill(found.F_x, *by_forces)
        G = self.gaps.fill(found.G_x, *by_gaps)
        return F, G, known[: slave.owned]

    def _normals(self, link: CoupledSides, u: fem.Function) -> Floats:
        """Return the averaged normals (n, d), on edges those of both sides; collective."""
        averaged = nodal_normals(link.sides.slave, coordinates(link.sides.slave, u))
        if self.edges is None:
            return averaged
        pairing, operators = link.mortar
        return edge_normals(pairing, operators.segments, u, averaged, self.edges)

    def _derivatives(
        self, link: CoupledSides, u: fem.Function, segments: Segments, keep: Bools, given: Tractions
    ) -> tuple[Derivatives, Floats]:
        """Return the derivatives on this rank, and the weighted dual functions; collective."""
        pairing, smooth = link.mortar[0], link.pattern.smooth
        Phi, sharing = weighted_duals(pairing, segments, keep), None
        if self.edges is not None:
            banned = link.banned[link.sides.slave.nodes]
            sharing = find_sharing(pairing, segments, u, keep, self.edges, banned)
            Phi = open_duals(pairing, segments, Phi, keep, sharing)
        at = pairing, u, segments, keep, Phi, given
        if _in_space(link):
            return differentiate_in_space(*at, smooth, sharing), Phi
        slopes = None if smooth is None else height_slopes(pairing, segments, u, smooth)
        return differentiate(*at, slopes, sharing), Phi

    def slips(
        self, link: CoupledSides, u: fem.Function, partners: Partners, since: PETSc.Vec
    ) -> SlipRows:
        """Return the rows of slips at the iterate that was differentiated last; collective."""
        own = slice(None, link.sides.slave.owned)
        n, turning = _turning(link, self._normals(link, u)[own])
        along = (partners.motion(link, since) * link.coupling.R[:, :, 0]).sum(axis=1)
        by_n = partners.motion_by_normals(link) - along[:, None, None] * np.eye(n.shape[1])
        by_n[~partners.known] = 0.0
        tangents = link.coupling.rows[:, 1:]
        N = (self.averaged if self.normals is None else self.normals).zero()
        return SlipRows(link, partners, tangents @ by_n @ turning, N, tangents)


def _in_space(link: CoupledSides) -> bool:
    return link.sides.V.mesh.topology.dim == 3


def facets_near(link: CoupledSides) -> Bools:
    """Return the slave facets (m,) of this rank that have nodes in T; collective."""
    slave, own = link.sides.slave, slice(None, link.sides.slave.owned)
    near = np.zeros((len(slave.nodes), 1))
    near[own, 0] = link.near
    return np.asarray((accumulate(slave, near)[:, 0] > 0.0)[slave.facets].any(axis=1))


def _neighbours(slave: Surface, marked: Bools) -> Bools:
    """Return the local slave nodes (n,) of facets, of any rank, with a marked node; collective."""
    found = np.zeros((len(slave.nodes), 1))
    found[slave.facets[marked[slave.facets].any(axis=1)]] = 1.0
    return np.asarray(accumulate(slave, found)[:, 0] > 0.0)


def incidence(facets: Ints, nodes: Ints, shape: tuple[int, int]) -> sparse.csr_array:
    """Return which nodes (p, k) belong to facets (p,)."""
    rows = np.repeat(facets, nodes.shape[1])
    ones = np.ones(len(rows), dtype=np.int8)
    return sparse.coo_array((ones, (rows, nodes.ravel())), shape=shape).tocsr()


def layout_of(V: fem.FunctionSpace) -> Unknowns:
    """Return how the unknowns of a vector space are divided among ranks."""
    d, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    return Unknowns(d * index_map.size_local, d * index_map.size_global)


def _turning(link: CoupledSides, averaged: Floats) -> tuple[Floats, Floats]:
    """Return the normals n_j (n, d) of the owned slave nodes, 0 where not kept, and dn_j/dn.

    n_j is the averaged normal (n, d), or that on an edge, without the directions that mirror planes
    take.
    """
    kept = link.coupling.kept[:, 0]
    n = np.where(kept[:, None], link.coupling.normals, 0.0)
    free = ~link.sides.mirrors[: len(n)]
    left = np.linalg.norm(averaged * free, axis=1)
    turning = (np.eye(n.shape[1]) - n[:, :, None] * n[:, None, :]) * free[:, None, :]
    turning /= np.where(kept, left, 1.0)[:, None, None]
    turning[~kept] = 0.0
    return n, turning


def _tractions(
    link: CoupledSides, averaged: Floats, multipliers: Floats, tangential: Floats | None
) -> tuple[Tractions, Bools]:
    """Return normals, tractions, and which local slave nodes are kept; collective.

    Args:
        averaged: normals (local slave nodes, d).
        multipliers: lambda_j (owned nodes,).
        tangential: tangential tractions (owned nodes, d), None without friction.
    """
    slave, own = link.sides.slave, slice(None, link.sides.slave.owned)
    nodes, kept = link.nodes, link.coupling.kept[:, 0]
    n, turning = _turning(link, averaged[own])
    at = multipliers[nodes] * kept
    traction, change = at[:, None] * n, at[:, None, None] * turning
    if tangential is not None:
        along = tangential[nodes] - (tangential[nodes] * n).sum(axis=1)[:, None] * n
        along *= kept[:, None]
        traction += along
        change -= link.coupling.R[:, :, :1] * (along[:, None] @ turning)  # as tangents turn
    parts = n, turning, traction, change, kept
    d = n.shape[1]
    columns = np.zeros((len(slave.nodes), 2 * d + 2 * d * d + 1))
    widths = [math.prod(part.shape[1:]) for part in parts]  # a rank may have no node
    columns[own] = np.concatenate(
        [part.reshape(len(nodes), k) for part, k in zip(parts, widths, strict=True)], axis=1
    )
    ends = np.cumsum([d, d * d, d, d * d])
    n, turning, traction, change, mark = np.split(accumulate(slave, columns), ends, axis=1)
    square = (-1, d, d)
    found = Tractions(n, turning.reshape(square), traction, change.reshape(square))
    return found, mark[:, 0] > 0
