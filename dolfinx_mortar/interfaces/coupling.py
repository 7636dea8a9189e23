# SPDX-License-Identifier: MIT
"""Results of the search and the update of one interface, as immutable records.

See theory.md, Constraints become bounds:

    u_j = R_j w_j + sum_l Q_jl u_l,      Q_jl = R_j S_j R_j^-1 P_jl,     P = D^-1 (M - D_other)

D_other are the entries of D off the diagonal, of removed nodes and of vertices on which mid-side
nodes depend (`mortar.duals`). Smooth ties add D_jj^-1 int Phi_j A_l of
`curvature_correction.point_motions` to P_jl I.
Where a component e is prescribed and n = n_f + n_e e, R_j^-1 has the rows n, e, .., t, and R_j the
columns n_f / |n_f|^2, e - n_e n_f / |n_f|^2, .., t. A reaction z exerts R^-T z on the slave side
and -P^T R^-T z on the master.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.algebra.csr import BlockMatrix
from dolfinx_mortar.algebra.parallel import sums_at_nodes
from dolfinx_mortar.common.arrays import TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.common.spaces import with_ghosts
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.interfaces.constraints import check_shapes
from dolfinx_mortar.mortar.common_normals import CommonNormals, Spreads
from dolfinx_mortar.mortar.curvature_correction import NodeShape, SmoothSide
from dolfinx_mortar.mortar.duals import Coverage
from dolfinx_mortar.mortar.operators import MortarOperators
from dolfinx_mortar.mortar.pairing import Pairing, Weight
from dolfinx_mortar.mortar.surface import Surface, accumulate


@dataclass(frozen=True)
class Sides:
    """Surfaces of an interface."""

    V: fem.FunctionSpace
    slave: Surface
    master: Surface | None
    on_slave: Bools  # (local nodes,)
    on_master: Bools  # (local nodes,)
    fixed: Bools  # (local nodes, d) directions with Dirichlet data
    mirrors: Bools  # (local nodes, d) components across planes of symmetry
    dependent: Bools  # (n,) owned slave nodes that depend on others
    unilateral: bool
    weight: Weight | None = None  # of all integrals; None for 1
    spreads: Spreads | None = None  # of contacts between two sides
    judged: Sequence[tuple[Bools, Floats]] = ()  # of both sides: `judge_supports`
    shapes: Sequence[NodeShape] = ()  # of both sides, if used: `find_shape`

    @property
    def meet_themselves(self) -> bool:
        """Whether both are one surface, divided at each search."""
        return self.master is self.slave

    @property
    def hold(self) -> bool:
        """Whether all directions are constrained, as by supports."""
        return self.master is None and not self.unilateral

    @property
    def nodes(self) -> Ints:
        """Local numbers (n,) of the owned slave nodes."""
        return self.slave.nodes[: self.slave.owned]

    @property
    def n_owned(self) -> int:
        """Number of owned nodes of V."""
        return int(self.V.dofmap.index_map.size_local)

    @property
    def surfaces(self) -> list[Surface]:
        """Slave surface, and the master's if there is one."""
        return [self.slave] if self.master is None else [self.slave, self.master]


@dataclass(frozen=True)
class Pattern:
    """Sparsity of the coupling."""

    row: Ints  # (e,) of the owned slave nodes
    column: Longs  # (e,) global node
    split: int  # entries before it are of D_other, others of M
    blocks: BlockMatrix  # for Q
    scalars: BlockMatrix  # for P
    smooth: tuple[SmoothSide, SmoothSide] | None = None  # in place of facets
    nearby: tuple[SmoothSide, SmoothSide] | None = None  # if facets are used


@dataclass(frozen=True)
class Coupling:
    """One configuration, at owned slave nodes."""

    blocks: Floats  # (e, d, d) entries of Q, read-only
    P: Floats  # (e, c) for c choices of direction
    R: Floats  # (n, d, d) frames as columns
    slot: Ints  # (n, d) column of R of a prescribed axis, else -1
    directions: Bools  # (n, d) constrained directions
    kept: Bools  # (n, c) nodes with a multiplier
    weight: Floats  # (n, c) D_jj, 0 without multiplier
    normals: Floats  # (n, d) outward; 0 if all directions are prescribed
    heights: Floats  # (n,) reduction of the gap n.(P x - x_j)
    coverage: Coverage
    offset: Floats | None = None  # (local slave nodes,) added to the gap
    operators: MortarOperators | None = None
    common: CommonNormals | None = None  # of contacts between two sides

    @cached_property
    def rows(self) -> Floats:
        """Rows of R^-1 (n, d, d), directions of motions and forces."""
        return np.asarray(np.linalg.inv(self.R))


def check_coupling(name: str, found: Coupling, sides: Sides, pattern: Pattern) -> None:
    """Raise a ValueError for wrong shapes, non-finite values or singular frames."""
    n, d, e = len(sides.nodes), sides.fixed.shape[1], len(pattern.row)
    c = np.shape(found.kept)[-1] if np.ndim(found.kept) == 2 else 1
    shapes = {
        "blocks": (e, d, d),
        "P": (e, c),
        "R": (n, d, d),
        "slot": (n, d),
        "directions": (n, d),
        "kept": (n, c),
        "weight": (n, c),
        "normals": (n, d),
        "heights": (n,),
    }
    check_shapes(name, found, shapes)
    size = np.linalg.norm(found.R, axis=1).prod(axis=1)
    if not (np.abs(np.linalg.det(found.R)) > ROUND_OFF * size).all():
        raise ValueError(f"{name} R without inverse: give independent columns")


def create_blocks(V: fem.FunctionSpace, rows: Ints, columns: Longs) -> BlockMatrix:
    """Matrix of d x d blocks at owned ``rows``, global ``columns``; collective."""
    return BlockMatrix(V.mesh.comm, V.dofmap.index_map, V.dofmap.index_map_bs, rows, columns)


def create_pattern(
    sides: Sides,
    row: Ints,
    column: Longs,
    split: int,
    smooth: tuple[SmoothSide, SmoothSide] | None = None,
    nearby: tuple[SmoothSide, SmoothSide] | None = None,
) -> Pattern:
    """Create a pattern; collective."""
    V, rows = sides.V, sides.nodes[row]
    scalars = BlockMatrix(V.mesh.comm, V.dofmap.index_map, 1, rows, column)
    return Pattern(row, column, split, create_blocks(V, rows, column), scalars, smooth, nearby)


def mark(surface: Surface) -> Bools:
    """Nodes (local nodes,) on a surface; collective."""
    owned = np.zeros(surface.V.dofmap.index_map.size_local, dtype=bool)
    owned[surface.nodes[: surface.owned]] = True
    return with_ghosts(surface.V, owned)


def on_facets(side: Surface, which: npt.ArrayLike) -> Bools:
    """Local nodes (n,) of facets (m,) that are marked on any rank; collective."""
    marks = np.zeros(len(side.nodes))
    marks[side.facets[np.asarray(which)]] = 1.0
    return np.asarray(accumulate(side, marks) > 0.0)


@dataclass(frozen=True)
class CoupledSides:
    """An interface after search and update."""

    sides: Sides
    pairing: Pairing | None  # None without a master
    pattern: Pattern
    coupling: Coupling
    banned: Bools  # (local nodes,) slave nodes of other interfaces

    @property
    def unilateral(self) -> bool:
        """Whether the sides can separate."""
        return self.sides.unilateral

    @property
    def nodes(self) -> Ints:
        """Local numbers (n,) of the owned slave nodes."""
        return self.sides.nodes

    @property
    def mortar(self) -> tuple[Pairing, MortarOperators]:
        """Facet pairs and operators of a link with a master."""
        assert self.pairing is not None and self.coupling.operators is not None
        return self.pairing, self.coupling.operators

    @property
    def Q(self) -> PETSc.Mat:
        """Q, in memory that the pattern's configurations share."""
        return self.pattern.blocks.of(self.coupling.blocks)

    @property
    def constrained(self) -> Bools:
        """Constrained directions (n, d)."""
        return self.coupling.directions

    def relative(self, v: PETSc.Vec) -> Floats:
        """Return R^-1 (v_j - sum_l Q_jl v_l) (n, d); collective.

        In constrained directions R_j^-1 (v_j - P v).
        """
        difference = v.array_r - (self.Q * v).array_r
        local = difference.reshape(-1, self.coupling.R.shape[1])[self.nodes]
        return np.asarray(np.einsum("nij,nj->ni", self.coupling.rows, local))

    def gaps(self, v: PETSc.Vec) -> Floats:
        """Return n_j.(P v - v_j) - h_j (n,) for v = X + u; collective.

        Without a master P = 0, and -h_j is the position of the tool along the normal.
        """
        normals = self.coupling.normals
        moved = (self.Q * v).array_r - v.array_r
        along = (moved.reshape(-1, normals.shape[1])[self.nodes] * normals).sum(axis=1)
        return np.asarray(along - self.coupling.heights)

    def constrained_motion(self, v: PETSc.Vec) -> Floats:
        """Constrained components of the relative motion; collective."""
        return np.asarray(self.relative(v)[self.coupling.directions])

    def transpose(self, forces: Floats) -> tuple[Floats, Floats]:
        """Owned nodal forces (I - Q)^T v of slave forces v (n, d); collective.

        On the slave side (I and D) and on the master side (M).
        """
        moved = -np.einsum("eij,ei->ej", self.coupling.blocks, forces[self.pattern.row])
        return self._on_both_sides(forces, moved)

    def exert(self, forces: Floats) -> tuple[Floats, Floats]:
        """Same with P for Q, for forces in any direction; collective."""
        row = self.pattern.row
        return self._on_both_sides(forces, -self.coupling.P[:, :1] * forces[row])

    def _on_both_sides(self, forces: Floats, moved: Floats) -> tuple[Floats, Floats]:
        p, V = self.pattern, self.sides.V
        slave, master = (
            sums_at_nodes(V.mesh.comm, V.dofmap.index_map, p.column[part], moved[part])
            for part in (slice(None, p.split), slice(p.split, None))
        )
        slave[self.nodes] += forces
        return slave, master


def with_offset(
    coupling: Coupling, sides: Sides, pattern: Pattern, offset: Floats | None
) -> Coupling:
    """Coupling with D_jj^-1 sum_l D_jl o_l added to gaps, o at local slave nodes; collective."""
    if offset is None:
        return coupling
    P, own = pattern.scalars, np.arange(len(pattern.row)) < pattern.split
    P.fill((coupling.P[:, 0] * own)[:, None, None])
    w = P.matrix.createVecRight()
    w.array[:] = 0.0
    w.array[sides.nodes] = offset[: sides.slave.owned]
    mean = (w.array_r - (P.matrix * w).array_r)[sides.nodes]
    heights = coupling.heights - np.where(coupling.kept[:, 0], mean, 0.0)
    return replace(coupling, heights=heights, offset=offset)


def relative_motions(coupled: CoupledSides, v: PETSc.Vec) -> Floats:
    """Return D^-1 (D - M) v (c, n, d), 0 without multiplier; collective."""
    P, coupling = coupled.pattern.scalars, coupled.coupling
    result = np.zeros((coupling.P.shape[1], *coupling.normals.shape))
    for c in range(len(result)):
        P.fill(coupling.P[:, c, None, None])
        result[c] = node_motions(coupled, P.matrix, v)
    return np.where(coupling.kept.T[:, :, None], result, 0.0)


def node_motions(coupled: CoupledSides, P: PETSc.Mat, v: PETSc.Vec) -> Floats:
    """Return v_j - sum_l P_jl v_l (n, d) at the slave nodes; collective."""
    d = coupled.coupling.normals.shape[1]
    w, result = P.createVecRight(), np.zeros((len(coupled.nodes), d))
    for i in range(d):
        w.array[:] = v.array_r[i::d]
        result[:, i] = (w.array_r - (P * w).array_r)[coupled.nodes]
    return result


def along_and_across(relative: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Normal part and length of the tangential part of motions (.., d).

    >>> along_and_across(np.array([[3.0, -2.0]]), np.array([[0.0, 1.0]]))
    (array([-2.]), array([3.]))
    """
    along = (relative * normals).sum(axis=-1)
    return along, np.linalg.norm(relative - along[..., None] * normals, axis=-1)


def slipped(coupled: CoupledSides, u: PETSc.Vec) -> Floats:
    """Tangential part (n,) of D^-1 (D - M) u, the largest of the choices; collective."""
    _, across = along_and_across(relative_motions(coupled, u), coupled.coupling.normals)
    return np.asarray(across.max(axis=0))


def normal_frames(normals: Floats, kept: Bools, fixed: Bools) -> tuple[Floats, Ints, Bools]:
    """Frames whose normal is constrained at kept nodes (n,); Cartesian elsewhere.

    Prescribed axes (n, d) are among the tangents. Returns R and slot of a `Coupling`, and the
    constrained directions (n, d).

    >>> n, e = np.array([[0.6, 0.8]]), np.array([[True, False]])
    >>> R, slot, directions = normal_frames(n, np.array([True]), e)
    >>> np.linalg.inv(R[0]).round(12).tolist(), slot[0].tolist()
    ([[0.6, 0.8], [1.0, 0.0]], [1, -1])
    """
    n, d = normals.shape
    R, axes = np.tile(np.eye(d), (n, 1, 1)), np.arange(d, dtype=np.int32)
    slot = np.where(fixed, axes, -1).astype(np.int32)
    free, _ = free_directions(normals[kept], fixed[kept])
    # without the free axis closest to n; swapped tangents would spoil reused multigrid levels
    order = np.argsort(np.abs(free) - 2.0 * fixed[kept], axis=1, kind="stable")[:, : d - 1]
    order = np.sort(order, axis=1)
    columns = np.concatenate([free[:, None, :], np.eye(d)[order]], axis=1)
    Q, upper = np.linalg.qr(np.swapaxes(columns, 1, 2))
    Q = Q * np.sign(np.einsum("nii->ni", upper))[:, None, :] + 0.0
    shares = np.einsum("nij,ni->nj", Q, normals[kept])  # of n = sum_k shares_k q_k
    Q[:, :, 0] /= shares[:, :1]
    Q[:, :, 1:] -= Q[:, :, :1] * shares[:, None, 1:]
    place = np.zeros((len(free), d), dtype=np.int32)
    np.put_along_axis(place, order, axes[None, 1:], axis=1)
    R[kept], slot[kept] = Q, np.where(fixed[kept], place, -1)
    return R, slot, kept[:, None] & (axes == 0)


def free_directions(normals: Floats, fixed: Bools) -> tuple[Floats, Floats]:
    """Unit normals (n, d), or 0, without prescribed directions, and their lengths."""
    free = normals * ~fixed
    left = np.linalg.norm(free, axis=1)
    some = (left > ROUND_OFF)[:, None]
    return np.where(some, free / np.maximum(left, TINY)[:, None], 0.0), left


def create_coupling(
    pattern: Pattern,
    P: Floats,
    normals: Floats,
    fixed: Bools,
    kept: Bools,
    *,
    tangential: bool,
    added: Floats | None = None,
    **rest: Any,
) -> Coupling:
    """Coupling for P (e, c), unit normals (n, d), fixed directions (n, d), kept nodes (n, c).

    Frames have the normal first where it is kept, and are Cartesian elsewhere and for c > 1.

    Args:
        tangential: whether free tangents are constrained, too.
        added: (k, d, d) added to the last entries of Q.
    """
    R, slot, directions = normal_frames(normals, kept[:, 0] & (kept.shape[1] == 1), fixed)
    if tangential:
        directions = kept & ~(slot[:, :, None] == np.arange(R.shape[1])).any(axis=1)
    blocks = P[:, :, None] * (R * directions[:, None] @ np.linalg.inv(R))[pattern.row]
    if added is not None:
        blocks[len(blocks) - len(added) :] += added
    blocks.flags.writeable = False
    normals = np.where(kept.any(axis=1, keepdims=True), normals, 0.0)
    return Coupling(blocks, P, R, slot, directions, kept, normals=normals, **rest)
