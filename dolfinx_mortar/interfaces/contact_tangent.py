# SPDX-License-Identifier: MIT
"""Derivatives of forces, weighted gaps and slips of one contact by the displacement.

See `moving_geometry` and `mortar.tangent`. Below a tool tractions turn with dn_j = -(I - n n^T)
Hess phi dx_j. Changes of heights of second order by normal strain are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.algebra.csr import (
    BlockEntries,
    Blocks,
    SumWithProducts,
    Triplets,
    owned_rows,
)
from dolfinx_mortar.common.arrays import TINY, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import scaled_normals
from dolfinx_mortar.interfaces.coupling import CoupledSides, on_facets
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import SidePattern, Tool, find_facing, point_gaps
from dolfinx_mortar.mortar.common_normals import carried, in_planes
from dolfinx_mortar.mortar.curvature_correction import side_slopes
from dolfinx_mortar.mortar.duals import find_duals
from dolfinx_mortar.mortar.integrals import some_points
from dolfinx_mortar.mortar.operators import rule_of, whole_facets
from dolfinx_mortar.mortar.pairing import receive
from dolfinx_mortar.mortar.surface import (
    accumulate,
    coordinates,
    facets_at,
    nodal_normals,
)
from dolfinx_mortar.mortar.tangent import (
    Derivatives,
    Tractions,
    differentiate,
    differentiate_whole,
    normal_derivatives,
)
from dolfinx_mortar.shapes.shape import unit_vectors


@dataclass(frozen=True)
class Unknowns:
    """Layout of the unknowns of a vector space, see `algebra.csr.Layout`."""

    size_local: int
    size_global: int


class LinkDerivatives:
    """Derivatives of the forces and weighted gaps of one contact, F_x + F_n C + F_p N.

    C are derivatives of contact normals, N of averaged ones (for projections in 2D).
    """

    def __init__(self, link: CoupledSides, tool: Tool | None) -> None:
        V, slave, pairing = link.sides.V, link.sides.slave, link.pairing
        self._found, self._tool = pairing, tool
        n, d = len(slave.nodes), V.dofmap.index_map_bs
        facets: Ints = np.arange(len(slave.facets), dtype=np.int32)
        on_slave = on_both = incidence(facets, slave.facets, (len(facets), n))
        nodes = both = V.dofmap.index_map.local_to_global(slave.nodes).astype(np.int64)
        if pairing is not None:
            pairs, shape = pairing.pairs, (len(facets), len(pairing.master_nodes))
            on_master = incidence(pairs[:, 0], pairing.master_facets[pairs[:, 1]], shape)
            on_both = scipy.sparse.hstack([on_slave, on_master]).tocsr()
            both = np.concatenate([nodes, pairing.master_nodes])
        by_x = (d * both[:, None] + np.arange(d)).ravel()
        by_n, forces, gaps = by_x[: d * n], by_x, d * nodes
        of = V.mesh.comm, layout_of(V)
        self.normals: _Normals | Triplets
        if tool is not None:
            self.normals = _between_nodes(V, link.nodes[:, None])
        else:
            self.averaged = _between_nodes(V, slave.nodes[slave.facets])
            x = BlockEntries(on_slave.T @ on_both, (d, d), by_n, by_x)
            y = BlockEntries(on_slave.T @ on_slave, (d, d), by_n, by_n)
            self.normals = _Normals(link, x, y, self.averaged.zero())
        self.in_plane = d == 2 and tool is None
        turned = [self.normals.zero(), *([self.averaged.zero()] if self.in_plane else [])]
        by_forces, by_gaps = (
            [(BlockEntries(pattern.T @ on_slave, (i, d), rows, by_n), A) for A in turned]
            for pattern, i, rows in ((on_both, d, forces), (on_slave, 1, gaps))
        )
        x = BlockEntries(on_both.T @ on_both, (d, d), forces, by_x)
        self.forces = SumWithProducts(*of, x, *by_forces)
        x = BlockEntries(on_slave.T @ on_both, (1, d), gaps, by_x)
        self.gaps = SumWithProducts(*of, x, *by_gaps)

    def serves(self, link: CoupledSides) -> bool:
        """Whether a link has the same pairs."""
        names = "pairs", "master_facets", "master_nodes"
        both = self._found, link.pairing
        return self._tool is not None or all(
            np.array_equal(*(getattr(one, name) for one in both)) for name in names
        )

    def differentiate(
        self, link: CoupledSides, u: fem.Function, multipliers: Floats, tangential: Floats | None
    ) -> tuple[PETSc.Mat, PETSc.Mat, Bools]:
        """Derivatives d(B^T lambda)/du, dG_j in rows w_n, and which (n,) are known; collective.

        The next call refills the matrices. In space known rows are those near loaded facets.
        Multipliers are lambda_j (owned nodes,), tangential tractions (owned nodes, d).
        """
        slave, x = link.sides.slave, coordinates(link.sides.slave, u)
        given, keep = tractions_of(link, multipliers, tangential)
        known: Bools = np.ones(len(x), dtype=bool)
        C: PETSc.Mat
        if self._tool is not None:
            assert isinstance(self.normals, Triplets)
            found = _below_tool(link, self._tool, u, given, keep)
            C = self.normals.fill(_turning(self._tool, x[: slave.owned])[:, None, :, None])
        else:
            assert isinstance(self.normals, _Normals)
            (pairing, operators), common = link.mortar, link.coupling.common
            segments = operators.segments
            if not self.in_plane:
                loaded: Bools = np.asarray(given.tractions.any(axis=1))
                known = on_facets(slave, loaded[slave.facets].any(axis=1))
                asked: Bools = np.asarray(known[slave.facets].any(axis=1))
                segments = some_points(segments, asked[segments.slave])
            assert common is not None
            at = pairing, u, segments, keep, given, link.pattern.smooth
            found = differentiate(*at, receive(pairing, common.of_master))
            N = self.averaged.fill(normal_derivatives(slave, x))
            C = self.normals.fill(link, u, found)
        parts = [(found.F_n, found.G_n, C)]
        parts += [(found.F_p, found.G_p, N)] if self.in_plane else []
        F = self.forces.fill(found.F_x, *((F_n, A) for F_n, _, A in parts))
        G = self.gaps.fill(found.G_x, *((G_n, A) for _, G_n, A in parts))
        return F, G, known[: slave.owned]

    def slips(
        self, link: CoupledSides, partners: Partners, since: PETSc.Vec
    ) -> scipy.sparse.csr_array:
        """Rows (d n, unknowns) of slips t.m at the last iterate; 0 of normals, without partners.

        By the motions du_j - P du, and by the normals, also as the tangents t turn along n;
        collective.
        """
        tangents, nodes = link.coupling.rows[:, 1:], link.nodes
        n, _, d = tangents.shape
        by_x, by_n = partners.derivatives(link, since)
        along = (partners.motion(link, since) * link.coupling.R[:, :, 0]).sum(axis=1)
        by_n = by_n - along[:, None, None] * np.eye(d)
        P, first = owned_rows(partners.P)[nodes], link.sides.V.dofmap.index_map.local_range[0]
        own = scipy.sparse.csr_array((np.ones(n), nodes + first, np.arange(n + 1)), shape=P.shape)
        moved = scipy.sparse.kron(own - P, scipy.sparse.eye_array(d), format="csr")
        turned = owned_rows(self.normals.zero())[(d * nodes[:, None] + np.arange(d)).ravel()]
        row, column = d * np.arange(n)[:, None, None] + np.indices((d, d))[:, 1:, :][:, None]
        parts = []
        for vectors, rows in ((tangents @ by_x, moved), (tangents @ by_n, turned)):
            known = vectors * partners.known[:, None, None]
            at = row.ravel(), column.ravel()
            parts.append(scipy.sparse.coo_array((known.ravel(), at), (d * n, d * n)).tocsr() @ rows)
        return scipy.sparse.csr_array(parts[0] + parts[1])


class _Normals:
    """Derivatives of the normals of contact, Y_s dn_j + Y_m sum_l (dM_jl n_l + M_jl dn_l).

    Left out: weights of spreads by M, and facets at edges in only one of the averages.
    """

    def __init__(self, link: CoupledSides, x: BlockEntries, y: BlockEntries, N: PETSc.Mat) -> None:
        """Patterns; x, y: sum_l dM_jl n_l by coordinates, by normals N; collective."""
        V, pattern, n = link.sides.V, link.pattern, len(link.nodes)
        assert link.sides.master is not None
        d, of = V.dofmap.index_map_bs, (V.mesh.comm, layout_of(V))
        master = link.sides.master
        self._d, self._N = d, N
        self._of_master = _between_nodes(V, master.nodes[master.facets])
        own = V.dofmap.index_map.local_to_global(link.nodes).astype(np.int64)
        self._row = pattern.row[pattern.split :]
        columns, place = np.unique(pattern.column[pattern.split :], return_inverse=True)
        self._column: Ints = place.astype(np.int32)
        rows, others = ((d * at[:, None] + np.arange(d)).ravel() for at in (own, columns))
        coupled = incidence(self._row, self._column[:, None], (n, len(columns)))
        M = BlockEntries(coupled, (d, d), rows, others)
        self._facing = SumWithProducts(*of, x, (y, N), (M, self._of_master.zero()))
        none, one = (
            BlockEntries(scipy.sparse.csr_array(pattern), (d, d), rows, rows)
            for pattern in (scipy.sparse.csr_array((n, n)), scipy.sparse.eye_array(n))
        )
        self._sum = SumWithProducts(*of, none, (one, N), (one, self._facing.zero()))

    def zero(self) -> PETSc.Mat:
        return self._sum.zero()

    def fill(self, link: CoupledSides, u: fem.Function, found: Derivatives) -> PETSc.Mat:
        master, spreads, common = link.sides.master, link.sides.spreads, link.coupling.common
        assert master is not None and spreads is not None and common is not None
        x, own, M = coordinates(master, u), np.zeros(master.X.shape), link.mortar[1].M[:, :1]
        n, by_n = in_planes(nodal_normals(master, x), spreads.mirrors[master.nodes])
        own[: master.owned] = common.of_master
        by_n = (carried(n, accumulate(master, own)) @ by_n)[master.facets]
        terms = normal_derivatives(master, x)
        N_m = self._of_master.fill(np.einsum("mkij,mkjla->mkila", by_n, terms, optimize=True))
        at = M[:, :, None, None, None] * np.eye(self._d)[:, None]
        facing = self._facing.fill(
            found.b_x,
            (found.b_p, self._N),
            ([Blocks(self._row[:, None], self._column[:, None], at)], N_m),
        )
        nodes: Ints = np.arange(len(link.nodes), dtype=np.int32)[:, None]
        by_slave, by_master = (
            [Blocks(nodes, nodes, Y[:, None, :, None])] for Y in common.differentiate()
        )
        return self._sum.fill([], (by_slave, self._N), (by_master, facing))


def _between_nodes(V: fem.FunctionSpace, nodes: Ints) -> Triplets:
    """Matrix of blocks between local nodes (m, k) of facets, or of one node each."""
    d, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    globally = index_map.local_to_global(nodes.ravel()).astype(np.int64).reshape(nodes.shape)
    at = d * globally[:, :, None] + np.arange(d)
    block = *at.shape, *at.shape[1:]
    rows = np.broadcast_to(at[:, :, :, None, None], block)
    columns = np.broadcast_to(at[:, None, None], block)
    return Triplets(V.mesh.comm, layout_of(V), rows, columns)


def incidence(facets: Ints, nodes: Ints, shape: tuple[int, int]) -> scipy.sparse.csr_array:
    """Incidence of facets (p,) and their nodes (p, k)."""
    rows = np.repeat(facets, nodes.shape[1])
    ones = np.ones(len(rows), dtype=bool)  # sums of small integers may overflow to 0
    return scipy.sparse.coo_array((ones, (rows, nodes.ravel())), shape=shape).tocsr()


def layout_of(V: fem.FunctionSpace) -> Unknowns:
    """Division of unknowns among ranks."""
    d, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    return Unknowns(d * index_map.size_local, d * index_map.size_global)


def tractions_of(
    link: CoupledSides, multipliers: Floats, tangential: Floats | None
) -> tuple[Tractions, Bools]:
    """Normals, tractions, and local slave nodes with a multiplier; collective."""
    slave, nodes, kept = link.sides.slave, link.nodes, link.coupling.kept[:, :1]
    n = np.where(kept, link.coupling.normals, 0.0)
    at, d = multipliers[nodes, None], n.shape[1]
    traction, change = at * n, at[:, :, None] * np.eye(d)
    if tangential is not None:
        along = tangential[nodes] - (tangential[nodes] * n).sum(axis=1)[:, None] * n
        traction += along
        change -= link.coupling.R[:, :, :1] * along[:, None]  # as tangents turn
    offset = np.zeros(len(slave.nodes)) if link.coupling.offset is None else link.coupling.offset
    columns = np.zeros((len(slave.nodes), 2 * d + d * d + 1))
    columns[: slave.owned] = np.hstack([n, traction, change.reshape(len(n), d * d), kept])
    ends = np.cumsum([d, d, d * d])
    n, traction, change, mark = np.split(accumulate(slave, columns), ends, axis=1)
    return Tractions(n, traction, change.reshape(-1, d, d), offset), mark[:, 0] > 0


def _turning(tool: Tool, x: Floats) -> Floats:
    """Derivatives dn_j/dx_j (n, d, d) below a tool, n = -grad phi / |grad phi|; collective."""
    at = tool.distance(x)
    size, g = unit_vectors(at.gradient)
    across = np.eye(x.shape[1]) - g[:, :, None] * g[:, None]
    return -across @ at.hessian / np.maximum(size, TINY)[:, None, None]


def _below_tool(
    link: CoupledSides, tool: Tool, u: fem.Function, given: Tractions, keep: Bools
) -> Derivatives:
    """Derivatives on all facets that face a tool; collective."""
    slave, pattern, x = link.sides.slave, link.pattern, coordinates(link.sides.slave, u)
    assert isinstance(pattern, SidePattern) and pattern.side is not None
    side, d = pattern.side, x.shape[1]
    facing = find_facing(side, tool, x)
    segments, points = whole_facets(side, x, facing)
    phi, found = point_gaps(pattern, tool, u, segments, points)
    which, facets = np.flatnonzero(facing), facets_at(slave, x)[facing]
    nodes, k = slave.facets[which], slave.element.nodes
    slope = found.gradient[:, None]
    if pattern.nodal:
        slope = found.gradient[slave.facets[segments.slave]]
    by_x = segments.N[:, :, None] * slope
    if pattern.own is not None and not pattern.nodal:
        by_x -= side_slopes(slave, pattern.own, u, segments.slave, segments.xi_s)
    xi, _ = rule_of(slave.element)
    per_point = slave.element.size * segments.weight.reshape(-1, len(xi))
    per_point /= np.linalg.norm(scaled_normals(facets, xi), axis=2)
    duals = find_duals(side, segments, keep).of(which)
    at = per_point, phi.reshape(per_point.shape), by_x.reshape(*per_point.shape, k, d)
    forces, gaps, D = differentiate_whole(
        facets, xi, *at, duals, given.tractions[nodes], given.offset[nodes]
    )
    by_n = np.einsum("fjl,fjic->flijc", D, given.changes[nodes])
    F_x, F_n, G_x = ([Blocks(nodes, nodes, v)] for v in (forces, by_n, gaps[:, :, None]))
    return Derivatives(F_x, F_n, G_x, G_n=[])
