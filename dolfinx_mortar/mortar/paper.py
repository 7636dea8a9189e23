# SPDX-License-Identifier: MIT
"""The matrices D, M and N of the paper (eqs. 16 to 20), for users and tests.

They consist of the entries of the solver's `operators`, times the identity. The solver has the
normals of `common_normals`, here only with `feature_angle`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy

import dolfinx
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.csr import csr_of
from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.mortar.common_normals import common_normals, find_spreads
from dolfinx_mortar.mortar.facing_bodies import check_angle
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.operators import create_operators
from dolfinx_mortar.mortar.pairing import Weight, create_pairing
from dolfinx_mortar.mortar.surface import create_surface, find_boundary
from dolfinx_mortar.spaces import check_space, find_positions


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


def _expand_rows(A: PETSc.Mat, rows: Ints, V: dolfinx.fem.FunctionSpace) -> PETSc.Mat:
    """Return owned rows of a node matrix, every entry times the d x d identity (eqs. 19, 20)."""
    d, index_map = V.dofmap.index_map_bs, V.dofmap.index_map
    start, columns, values = csr_of(A)
    shape = (index_map.size_local, index_map.size_global)
    expanded = scipy.sparse.kron(
        scipy.sparse.csr_array((values, columns, start), shape=shape)[rows], np.eye(d), "csr"
    )
    indices = (v.astype(PETSc.IntType) for v in (expanded.indptr, expanded.indices))
    sizes = ((d * len(rows), None), (d * index_map.size_local, d * index_map.size_global))
    return PETSc.Mat().createAIJ(sizes, csr=(*indices, expanded.data), comm=V.mesh.comm)


def _create_normal_matrix(comm: MPI.Intracomm, normals: Floats) -> PETSc.Mat:
    """Return N (d * m, m) of eq. 17, block diagonal of the normals (m of this rank, d)."""
    m, d = normals.shape
    first = comm.exscan(m) or 0
    columns = (first + np.repeat(np.arange(m), d)).astype(PETSc.IntType)
    start = np.arange(m * d + 1, dtype=PETSc.IntType)
    sizes = ((m * d, None), (m, None))
    return PETSc.Mat().createAIJ(sizes, csr=(start, columns, normals.ravel()), comm=comm)


def assemble_mortar(
    V: dolfinx.fem.FunctionSpace,
    facet_tags: dolfinx.mesh.MeshTags,
    *,
    slave: int | str,
    master: int | str,
    u: dolfinx.fem.Function | None = None,
    weight: Weight | None = None,
    feature_angle: float | None = None,
) -> Mortar:
    """Assemble the paper's matrices D, M and N and the weighted gap (collective).

    Frictionless contact is B_I v <= c_I (eq. 16) for the displacement v with B_I = N^T (D - M) (eq.
    17) and c_I = -N^T (D - M) X (eq. 18); the weighted gap is c_I - B_I u. Sides are tied by (D -
    M) v = 0, also those of a scalar field.

    Args:
        V: vector or scalar Lagrange space of degree 1 or 2 on the mesh of all bodies.
        slave: tag or name of the side that carries the multipliers.
        master: tag or name of the other side.
        u: displacement, in V or in a vector Lagrange space of no higher degree on this mesh;
            segments, normals and gap are at X + u.
        weight: factor of all integrals at points X of the slave side, (q, d) -> (q,), such as 2 pi
            r; None for 1.
        feature_angle: least angle of an edge in degrees, for the normals of `Contact`; None for
            averaged normals.

    Raises:
        ValueError: On all ranks, for tags, spaces and displacements that do not fit.
    """
    check_space(V, scalar=True)
    given: dict[str, Any] = {"facet_tags": facet_tags, "slave": slave, "master": master, "u": u}
    given |= {"weight": weight, "feature_angle": feature_angle}
    check_same_on_all_ranks(V.mesh.comm, **given)
    if weight is not None and not callable(weight):
        raise ValueError(f"weight is {weight!r}: give a function of points (q, d), or None")
    if feature_angle is not None:
        check_angle(feature_angle)
    W, u = find_positions(V, u, same_nodes=True)
    surfaces = [create_surface(W, facet_tags, slave, "slave")]
    surfaces.append(create_surface(W, facet_tags, master, "master"))
    pairing = create_pairing(W, *surfaces, u, moving=False, weight=weight)
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
