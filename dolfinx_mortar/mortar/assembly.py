# SPDX-License-Identifier: MIT
"""Segments with the functions of both sides, and the paper's D, M and N, for users.

D, M and N (eqs. 16 to 20) have the entries of the solver's `operators`, times the identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy

import dolfinx
from dolfinx.fem import Function, FunctionSpace
from dolfinx_mortar.algebra.csr import matrix_of, owned_rows
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arrays import Floats, Ints, Longs, place
from dolfinx_mortar.common.spaces import check_space, find_positions
from dolfinx_mortar.geometry.facets import surface_gradients
from dolfinx_mortar.mortar.common_normals import common_normals, find_spreads
from dolfinx_mortar.mortar.facing_bodies import check_angle
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.operators import create_operators
from dolfinx_mortar.mortar.pairing import Weight, create_pairing
from dolfinx_mortar.mortar.surface import (
    Surface,
    cells_of,
    coordinates,
    create_surface,
    facets_at,
    find_boundary,
    send,
)


@dataclass(frozen=True, eq=False)
class Segments:
    """Quadrature points where two sides face each other, on the slave facets of this rank.

    Integrals over the covered part of the slave side are sums of weights times values over all
    ranks. A side has k functions in a cell; a vector space has d dofs for each.
    """

    x: Floats  # (n, d) points of the slave side at X + u
    weight: Floats  # (n,) of the slave side's area (2D: length) at X + u, positive
    normal: Floats  # (n, d) outward unit normals at X + u
    gap: Floats  # (n,) from x to the master along the normal; < 0: overlap
    slave_cells: Longs  # (n,) global
    master_cells: Longs  # (n,) global, perhaps of other ranks
    xi_slave: Floats  # (n, d) in the reference cells
    xi_master: Floats  # (n, d)
    slave_dofs: Longs  # (n, k) global dofs; (n, k, d) of a vector space
    master_dofs: Longs  # (n, k) or (n, k, d), perhaps of other ranks
    slave_values: Floats  # (n, k) values of the functions
    master_values: Floats  # (n, k)
    slave_gradients: Floats  # (n, k, d) by positions X + u
    master_gradients: Floats  # (n, k, d)


class _Cells(NamedTuple):
    number: Longs
    places: Ints  # (m, k) of the facet's nodes
    x: Floats  # (m, c, d) its nodes
    dofs: Longs


def _find_cells(V: FunctionSpace, side: Surface, u: Function | None, name: str) -> _Cells:
    W, d, cells = side.V, side.X.shape[1], cells_of(side)
    nodes = W.dofmap.list[cells]
    of_facets = side.nodes[side.facets]
    X = W.tabulate_dof_coordinates()[:, :d][nodes]
    x = X if u is None else X + u.x.array.reshape(-1, d)[nodes]
    slopes = _tabulate(W, W.element.basix_element.points)[1:]
    with raised_together(V.mesh.comm):
        before, now = (np.linalg.det(np.einsum("aqk,mki->mqai", slopes, v)) for v in (X, x))
        wrong = np.flatnonzero(~(before * now > 0.0).all(axis=1))
        if len(wrong):
            at = place(X[wrong[0]].mean(axis=0))
            raise ValueError(
                f"{len(wrong)} cells behind {name}={side.label} have no volume, or u turns them "
                f"inside out, such as the one that is around {at} at X; check mesh and u."
            )
    local, bs = V.dofmap.list[cells], V.dofmap.index_map_bs
    dofs = V.dofmap.index_map.local_to_global(local.ravel()).reshape(local.shape)
    return _Cells(
        V.mesh.topology.index_map(d).local_to_global(cells),
        np.argmax(nodes[:, None] == of_facets[:, :, None], axis=2).astype(np.int32),
        x,
        dofs if bs == 1 else bs * dofs[:, :, None] + np.arange(bs),
    )


def _tabulate(V: FunctionSpace, xi: Floats) -> Floats:
    one_more = np.vstack([xi, np.zeros(xi.shape[1])])  # basix 0.9 aborts without a point
    return V.element.basix_element.tabulate(1, one_more)[:, :-1, :, 0]


def _evaluate(
    V: FunctionSpace, side: Surface, cells: _Cells, which: Ints, on_facet: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Points xi, x, values (n, k) and gradients (n, k, d) of V."""
    W, N = side.V, side.element.shape_functions(on_facet)
    nodes = W.element.basix_element.points[cells.places[which]]
    xi = np.einsum("nk,nki->ni", N, nodes)
    of_W, of_V = _tabulate(W, xi), _tabulate(V, xi)
    x = np.einsum("nk,nki->ni", of_W[0], cells.x[which])
    slopes = np.einsum("ank,nki->nia", of_W[1:], cells.x[which])
    gradients = np.einsum("ank,nai->nki", of_V[1:], np.linalg.inv(slopes))
    return xi, x, of_V[0], gradients


def segments(
    V: FunctionSpace,
    facet_tags: dolfinx.mesh.MeshTags,
    *,
    slave: int | str,
    master: int | str,
    u: Function | None = None,
) -> Segments:
    """Return the points for integrals over an interface of non-matching meshes (collective).

    The slave side is divided at the edges of master facets: int N_i N_l = sum_q w_q N_i N_l over
    the covered part, exact where flat triangles, parallelograms or parallel lines face each other.

    Args:
        V: scalar or vector Lagrange space of degree 1 or 2 on the mesh of all bodies.
        slave: tag or name of the side that is integrated.
        master: tag or name of the other side.
        u: displacement, in any vector Lagrange space of degree 1 or 2 on this mesh: all results are
            at X + u; None for X.

    Returns:
        The points of this rank's slave facets, at any distance from the master; none where no
        master facet faces them, or only one behind a body.

    Raises:
        ValueError: On all ranks, for tags, spaces and displacements that do not fit.
    """
    check_space(V, scalar=True, on_cells=False)
    comm = V.mesh.comm
    check_same_on_all_ranks(comm, facet_tags=facet_tags, slave=slave, master=master, u=u)
    W, u = find_positions(V, u, same_nodes=False)
    names = {"slave": slave, "master": master}
    sides = [create_surface(W, facet_tags, tag, name) for name, tag in names.items()]
    pairing = create_pairing(*sides, u, moving=False)
    cells_s, cells_m = (
        _find_cells(V, side, u, name) for side, name in zip(sides, names, strict=True)
    )
    cells_m = _Cells(*send(comm, pairing.sent, *cells_m))
    points, _ = find_segments(pairing, u)
    s, m = points.slave, points.master
    with raised_together(comm):
        lost = np.flatnonzero(~np.isfinite(points.xi_m).all(axis=1))
        if len(lost):
            at = place(cells_s.x[s[lost[0]]].mean(axis=0))
            raise ValueError(
                f"{len(lost)} points of slave={sides[0].label} have none opposite on master="
                f"{sides[1].label}, whose curved facets are folded as seen from the slave, such as "
                f"one near {at} at X + u; check mesh and u."
            )
    xi_s, x_s, N_s, G_s = _evaluate(V, sides[0], cells_s, s, points.xi_s)
    xi_m, x_m, N_m, G_m = _evaluate(V, sides[1], cells_m, m, points.xi_m)
    _, normal = surface_gradients(facets_at(sides[0], coordinates(sides[0], u)), s, points.xi_s)
    return Segments(
        x=x_s,
        weight=points.weight,
        normal=normal,
        gap=((x_m - x_s) * normal).sum(axis=1),
        slave_cells=cells_s.number[s],
        master_cells=cells_m.number[m],
        xi_slave=xi_s,
        xi_master=xi_m,
        slave_dofs=cells_s.dofs[s],
        master_dofs=cells_m.dofs[m],
        slave_values=N_s,
        master_values=N_m,
        slave_gradients=G_s,
        master_gradients=G_m,
    )


@dataclass(frozen=True, eq=False)
class Mortar:
    """The paper's matrices. Row d*i + c belongs to component c of the slave node nodes[i].

    Rows are distributed like the slave nodes; nodes without multiplier have no row. For a scalar
    space row i belongs to nodes[i], without N and gap.
    """

    D: PETSc.Mat  # (d * m_I, dofs of V)
    M: PETSc.Mat  # (d * m_I, dofs of V)
    N: PETSc.Mat | None  # (d * m_I, m_I), column i: outward slave normal of nodes[i]
    gap: PETSc.Vec | None  # (m_I,) weighted gap -N^T (D - M)(X + u), positive where open
    nodes: Longs  # (m_I of this rank,) global nodes in the order of the rows


def _expand_rows(A: PETSc.Mat, rows: Ints, V: FunctionSpace) -> PETSc.Mat:
    d = V.dofmap.index_map_bs
    expanded = scipy.sparse.kron(owned_rows(A)[rows], np.eye(d), "csr")
    return matrix_of(V.mesh.comm, expanded, d * V.dofmap.index_map.size_local)


def _create_normal_matrix(comm: MPI.Intracomm, normals: Floats) -> PETSc.Mat:
    """N (d * m, m) of eq. 17, for normals (m of this rank, d)."""
    m, d = normals.shape
    first = comm.exscan(m) or 0
    places = first + np.arange(m).repeat(d), np.arange(m * d + 1)
    rows = scipy.sparse.csr_array((normals.ravel(), *places), shape=(m * d, first + m))
    return matrix_of(comm, rows, m)


def assemble_mortar(
    V: FunctionSpace,
    facet_tags: dolfinx.mesh.MeshTags,
    *,
    slave: int | str,
    master: int | str,
    u: Function | None = None,
    weight: Weight | None = None,
    feature_angle: float | None = None,
) -> Mortar:
    """Assemble the paper's matrices D, M and N and the weighted gap (collective).

    Frictionless contact is B_I v <= c_I (eq. 16) with B_I = N^T (D - M) (eq. 17) and c_I = -N^T (D
    - M) X (eq. 18); the weighted gap is c_I - B_I u. Sides are tied by (D - M) v = 0, also those of
    a scalar field.

    Args:
        V: vector or scalar Lagrange space of degree 1 or 2 on the mesh of all bodies.
        slave: tag or name of the side with the multipliers.
        master: tag or name of the other side.
        u: displacement, in V or in a vector Lagrange space of no higher degree on this mesh;
            segments, normals and gap are at X + u.
        weight: factor of all integrals at points X of the slave side, (q, d) -> (q,), such as 2 pi
            r.
        feature_angle: least angle of an edge in degrees, for normals as in `Contact`; None for
            averaged slave normals.

    Raises:
        ValueError: On all ranks, for tags, spaces and displacements that do not fit.
    """
    check_space(V, scalar=True)
    check_same_on_all_ranks(
        V.mesh.comm,
        facet_tags=facet_tags,
        slave=slave,
        master=master,
        u=u,
        weight=weight,
        feature_angle=feature_angle,
    )
    if weight is not None and not callable(weight):
        raise ValueError(f"weight is {weight!r}: give a function of points (q, d), or None")
    if feature_angle is not None:
        check_angle(feature_angle)
    W, u = find_positions(V, u, same_nodes=True)
    surfaces = [create_surface(W, facet_tags, slave, "slave")]
    surfaces.append(create_surface(W, facet_tags, master, "master"))
    pairing = create_pairing(*surfaces, u, moving=False, weight=weight)
    segments, averaged = find_segments(pairing, u)
    everything = np.ones((len(averaged), 1), dtype=bool)
    operators = create_operators(pairing, u, segments, averaged, everything)
    own = surfaces[0].nodes[: surfaces[0].owned]
    kept, normals = operators.kept[:, 0], operators.normals
    node_D = pairing.D.matrix(operators.D[:, 0])
    node_M = pairing.M.matrix(operators.M[:, 0])
    D, M = (_expand_rows(A, own[kept], V) for A in (node_D, node_M))
    nodes = V.dofmap.index_map.local_to_global(own[kept])
    if V.dofmap.index_map_bs == 1:
        return Mortar(D=D, M=M, N=None, gap=None, nodes=nodes)
    if feature_angle is not None:
        at = pairing, segments, operators.M[:, 0], u, averaged
        spreads = find_spreads(find_boundary(W), surfaces)
        normals = common_normals(*at, spreads, feature_angle).n
    N = _create_normal_matrix(V.mesh.comm, normals[kept])
    x, relative, gap = D.createVecRight(), D.createVecLeft(), N.createVecRight()
    d = V.dofmap.index_map_bs
    x.array[:] = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local, :d].ravel()
    if u is not None:
        x.array[:] += u.x.array[: x.local_size]
    (M - D).mult(x, relative)
    N.multTranspose(relative, gap)
    return Mortar(D=D, M=M, N=N, gap=gap, nodes=nodes)
