# SPDX-License-Identifier: MIT
r"""The exact linearisation of contact on moving surfaces.

At the iterate u, with forces B(u)^T lambda of contact in r(u) = B(u)^T lambda and weighted gaps
G(u) >= 0, Newton's method reads

    (K + H) du + B^T lambda+ = r,    G_j + dG_j.du >= 0,    H = d(B^T lambda)/du at fixed lambda.

The test functions are those of T, as for surfaces that do not move; du = T_g y, in which y_n is
-dG_j.du / D_jj, so that the gaps are bounds once more: K^ = T^T (K + H) T_g, unsymmetric. In the
rows of T_g the parts of neighbouring slave nodes are lumped on node j, so that they are rows of one
node. What that neglects is some per cent; it is known once du is, and belongs to the bounds then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np
from scipy import sparse

from dolfinx import fem
from dolfinx_mortar.algebra.triplets import Triplets
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.interfaces.basis import Transformation
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.curvature_correction import height_slopes
from dolfinx_mortar.mortar.derivatives import Tractions, differentiate
from dolfinx_mortar.mortar.integrals import some_points, weighted_duals
from dolfinx_mortar.mortar.space_derivatives import differentiate_in_space
from dolfinx_mortar.mortar.surface import (
    accumulate,
    coordinates,
    nodal_normals,
    normal_derivatives,
)

LEAST_ALONG = 0.25
"""A row dG_j whose own part has less than this share along n_j is replaced by that of T."""
_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Unknowns:
    """How the unknowns of a vector space are divided among ranks; see `algebra.blocks.Layout`."""

    size_local: int
    size_global: int


@dataclass(frozen=True)
class GeometryTangent:
    """What the motion of the surfaces adds to a linearisation."""

    H: PETSc.Mat  # (n, n) d(B^T lambda)/du
    trial: Transformation  # T_g
    gaps: PETSc.Mat  # (n, n) rows w_n of contacts: closing of the gaps, -dG_j.du / D_jj

    def closing(self, du: PETSc.Vec) -> Floats:
        """Return by how much du closes the gaps (n,), at the unknowns w_n; collective."""
        return np.array((self.gaps * du).array_r)


def linearise_geometry(
    links: Sequence[Link],
    order: list[int],
    u: fem.Function,
    multipliers: Floats,
    tangential: Floats | None,
) -> GeometryTangent:
    """Return the derivatives of the contacts at X + u; collective.

    Args:
        links: The interfaces, of which the ties stay at X.
        order: Topological order of the interfaces.
        u: Displacement.
        multipliers: lambda_j (owned nodes,).
        tangential: Tangential tractions (owned nodes, 2), None without friction.
    """
    V = u.function_space
    H, gaps = (_empty(V) for _ in range(2))
    moved = list(links)
    other = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
    for k, link in enumerate(links):
        if not link.interface.unilateral or link.coupling.operators is None:
            continue
        forces, rows = _assemble(link, u, multipliers, tangential)
        H.axpy(1.0, forces, other)
        closing, coupling = _trial(link, rows)
        gaps.axpy(1.0, closing, other)
        moved[k] = coupling
    T = Transformation(V, moved, order)
    T.update(moved)
    return GeometryTangent(H, T, gaps)


def _layout(V: fem.FunctionSpace) -> Unknowns:
    d, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    return Unknowns(d * index_map.size_local, d * index_map.size_global)


def _empty(V: fem.FunctionSpace) -> PETSc.Mat:
    """Return a zero matrix between the unknowns; collective."""
    none: Longs = np.zeros(0, dtype=np.int64)
    return _matrix(V, none, none, np.zeros(0))


def _matrix(V: fem.FunctionSpace, rows: Longs, columns: Longs, values: Floats) -> PETSc.Mat:
    """Return the sum over ranks of triplets between unknowns of V; collective."""
    triplets = Triplets(V.mesh.comm, _layout(V), rows, columns)
    return triplets.matrix(triplets.sum(values))


def _tractions(
    link: Link, u: fem.Function, multipliers: Floats, tangential: Floats | None
) -> tuple[Tractions, Bools, Bools]:
    """Return normals, tractions, and which local slave nodes are kept and near; collective."""
    slave, own = link.sides.slave, slice(None, link.sides.slave.owned)
    nodes, kept = link.nodes, link.coupling.kept[:, 0]
    averaged = nodal_normals(slave, coordinates(slave, u))[own]
    n = np.where(kept[:, None], link.coupling.normals, 0.0)
    free = ~link.sides.fixed[nodes]
    left = np.linalg.norm(averaged * free, axis=1)
    d = n.shape[1]
    turning = (np.eye(d) - n[:, :, None] * n[:, None, :]) * free[:, None, :]
    turning /= np.where(kept, left, 1.0)[:, None, None]
    still = ~kept if link.sides.edges is None else ~kept | link.sides.edges[own]
    turning[still] = 0.0
    at = multipliers[nodes] * kept
    traction, change = at[:, None] * n, at[:, None, None] * turning
    if tangential is not None:
        along = (tangential[nodes] * (n @ _TURN.T)).sum(axis=1)
        traction += along[:, None] * (n @ _TURN.T)
        change += along[:, None, None] * (_TURN @ turning)
    columns = np.zeros((len(slave.nodes), 2 * d + 2 * d * d + 2))
    parts = n, turning, traction, change, np.stack([kept, link.near], axis=1).astype(float)
    columns[own] = np.concatenate(
        [part.reshape(len(nodes), math.prod(part.shape[1:])) for part in parts], axis=1
    )
    ends = np.cumsum([d, d * d, d, d * d])
    n, turning, traction, change, marks = np.split(accumulate(slave, columns), ends, axis=1)
    square = (-1, d, d)
    found = Tractions(n, turning.reshape(square), traction, change.reshape(square))
    return found, marks[:, 0] > 0, marks[:, 1] > 0


def _assemble(
    link: Link, u: fem.Function, multipliers: Floats, tangential: Floats | None
) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Return the derivatives of forces and of weighted gaps, these in the rows w_n; collective."""
    V, slave, (pairing, operators) = link.sides.V, link.sides.slave, link.mortar
    given, keep, near = _tractions(link, u, multipliers, tangential)
    asked: Bools = np.asarray(near[slave.facets].any(axis=1))
    segments = some_points(operators.segments, asked[operators.segments.slave])
    Phi, smooth = weighted_duals(pairing, segments, keep), link.pattern.smooth
    at = pairing, u, segments, keep, Phi, given
    d = V.dofmap.index_map_bs
    if d == 2:
        slopes = None if smooth is None else height_slopes(pairing, segments, u, smooth)
        found = differentiate(*at, slopes)
    else:
        found = differentiate_in_space(*at, smooth)
    xyz = np.arange(d)
    nodes = V.dofmap.index_map.local_to_global(slave.nodes).astype(np.int64)
    on_slave = (d * nodes[:, None] + xyz).ravel()
    on_both = np.concatenate([on_slave, (d * pairing.master_nodes[:, None] + xyz).ravel()])
    blocks = normal_derivatives(slave, coordinates(slave, u))
    dofs = d * nodes[slave.facets][:, :, None] + xyz
    rows = np.broadcast_to(dofs[:, :, :, None, None], blocks.shape)
    columns = np.broadcast_to(dofs[:, None, None], blocks.shape)
    normals = _matrix(V, rows.ravel(), columns.ravel(), blocks.ravel())
    by_x, by_n = (on_both, on_both), (on_both, on_slave)
    F = _sum(V, (found.F_x, *by_x), (found.F_n, *by_n), normals)
    G = _sum(V, (found.G_x, d * nodes, on_both), (found.G_n, d * nodes, on_slave), normals)
    return F, G


Numbered = tuple[sparse.csr_array, Longs, Longs]


def _sum(V: fem.FunctionSpace, by_x: Numbered, by_n: Numbered, normals: PETSc.Mat) -> PETSc.Mat:
    """Return the derivative by the coordinates, that by the normals times theirs; collective."""
    direct, indirect = (
        _matrix(V, rows[part.row], columns[part.col], part.data)
        for part, rows, columns in ((A.tocoo(), i, j) for A, i, j in (by_x, by_n))
    )
    total = indirect.matMult(normals)
    total.axpy(1.0, direct, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return total


def _trial(link: Link, weighted: PETSc.Mat) -> tuple[PETSc.Mat, Link]:
    """Return the closing of the gaps, and the link with the rows of T_g; collective."""
    coupling, pattern, nodes = link.coupling, link.pattern, link.nodes
    start, columns, values = weighted.getValuesCSR()
    n, kept, d = len(start) - 1, coupling.kept[:, 0], coupling.R.shape[1]
    inverse = np.zeros(n)
    inverse[d * nodes[kept]] = -1.0 / coupling.weight[kept, 0]
    scale = weighted.createVecLeft()
    scale.array[:] = inverse
    weighted.diagonalScale(scale)
    rows = sparse.csr_array((values, columns, start), (n, weighted.getSize()[1]))[d * nodes]
    rows = sparse.csr_array(sparse.diags_array(inverse[d * nodes]) @ rows)
    master = np.arange(len(pattern.row)) >= pattern.split
    used = master | (coupling.P[:, 0] != 0.0)
    p = np.zeros((len(used), d))
    for i in range(d):
        p[used, i] = -_entries(rows, pattern.row[used], d * pattern.column[used] + i)
    own = np.zeros((len(nodes), d))
    entries = rows.tocoo()
    for i in range(d):
        of_i = np.where(entries.col % d == i, entries.data, 0.0)
        own[:, i] = np.bincount(entries.row, of_i, minlength=len(nodes))
        own[:, i] += np.bincount(pattern.row, p[:, i], minlength=len(nodes))
    R = coupling.R
    across = np.swapaxes(R, 1, 2)
    moves = kept & ((own * coupling.normals).sum(axis=1) > LEAST_ALONG)
    turned = np.concatenate([own[:, None], across[:, 1:]], axis=1)
    inverted = np.linalg.inv(np.where(moves[:, None, None], turned, across))
    row = pattern.row
    slips = coupling.directions[row, :, None]
    along = np.where(slips, coupling.P[:, :1, None] * across[row], 0.0)
    along[:, 0] = p
    blocks = np.where(moves[row][:, None, None], inverted[row] @ along, coupling.blocks)
    frames = np.where(moves[:, None, None], inverted, R)
    return weighted, replace(link, coupling=replace(coupling, R=frames, blocks=blocks))


def _entries(A: sparse.csr_array, rows: Ints, columns: Longs) -> Floats:
    """Return entries (e,) of a matrix, 0 where nothing is stored."""
    entries, N = A.tocoo(), A.shape[1]
    keys = entries.row.astype(np.int64) * N + entries.col
    order = np.argsort(keys)
    asked = rows.astype(np.int64) * N + columns
    place = np.minimum(np.searchsorted(keys, asked, sorter=order), len(keys) - 1)
    if not len(keys):
        return np.zeros(len(asked))
    return np.where(keys[order[place]] == asked, entries.data[order[place]], 0.0)
