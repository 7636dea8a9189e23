# SPDX-License-Identifier: MIT
"""What a search and an update find for one interface: records, made anew and never changed.

At a kept slave node j with frame R_j = (n_j, t_j, ..) the displacement is written

    u_j = R_j w_j + sum_l Q_jl u_l,      Q_jl = R_j S_j R_j^T P_jl,      P = D^-1 (M - D_other)

with D on the diagonal, and D_other its other entries: columns of removed nodes, and of the vertices
on which mid-side nodes of six-node triangles depend (`dolfinx_mortar.mortar.dual`). Here
S_j = diag(1 in constrained directions); for ties of smooth surfaces P_jl I is completed by the
motions D_jj^-1 int Phi_j A_l of `dolfinx_mortar.geometry.offset_vectors`. Then w is the relative
displacement of the two sides in those directions, and every constraint is a bound on w. Without a
master Q is empty, and w the motion of the node itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra.blocks import BlockMatrix
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.interfaces.constraints import check_shapes
from dolfinx_mortar.mortar.curvature_correction import SmoothSide
from dolfinx_mortar.mortar.integrals import Coverage
from dolfinx_mortar.mortar.operators import MortarOperators
from dolfinx_mortar.mortar.pairing import Weight
from dolfinx_mortar.mortar.surface import Surface


@dataclass(frozen=True)
class Sides:
    """The surfaces of an interface in the space of the displacement."""

    V: fem.FunctionSpace
    slave: Surface
    master: Surface | None  # None where it is no part of the mesh
    on_slave: Bools  # (local nodes,)
    on_master: Bools  # (local nodes,)
    fixed: Bools  # (local nodes, d) directions with Dirichlet data
    dependent: Bools  # (n,) owned slave nodes that depend on other ones, which may be kept
    edges: Bools | None = None  # (n,) slave nodes on edges where a contact has normals of its own
    weight: Weight | None = None  # of all integrals over the interface; None for 1

    @property
    def nodes(self) -> Ints:
        """Local numbers (n,) of the slave nodes that this rank owns."""
        return self.slave.nodes[: self.slave.owned]

    @property
    def n_owned(self) -> int:
        """How many nodes of V this rank owns."""
        return int(self.V.dofmap.index_map.size_local)

    @property
    def surfaces(self) -> list[Surface]:
        """The slave surface, and the master's if there is one."""
        return [self.slave] if self.master is None else [self.slave, self.master]


@dataclass(frozen=True)
class Pattern:
    """Where an interface couples slave rows to other nodes; fixed between two searches."""

    row: Ints  # (e,) index into the owned slave nodes
    column: Longs  # (e,) global node
    split: int  # entries before it are of the slave side (D_other), the others of the master (M)
    blocks: BlockMatrix  # holds Q
    scalars: BlockMatrix  # holds P
    smooth: tuple[SmoothSide, SmoothSide] | None = None  # where facets stand for them
    nearby: tuple[SmoothSide, SmoothSide] | None = None  # those of a contact that keeps to facets


@dataclass(frozen=True)
class Coupling:
    """Frames, weights and Q of one interface in one configuration, at its owned slave nodes."""

    blocks: Floats  # (e, d, d) entries of Q on the pattern, read-only
    P: Floats  # (e, c) D^-1 (M - D_other) on the pattern, for each of c choices of direction
    R: Floats  # (n, d, d) frames; columns are the directions, which the interface chooses
    slot: Ints  # (n, d) column of R that is a prescribed Cartesian direction, else -1
    directions: Bools  # (n, d) which directions of the frame the interface constrains
    kept: Bools  # (n, c) nodes that carry a multiplier
    weight: Floats  # (n, c) D_jj, 0 where not kept
    normals: Floats  # (n, d) outward, without prescribed directions; 0 if nothing else is left
    heights: Floats  # (n,) by how much the gap is smaller than n.(P x - x_j), see `Link.gaps`
    coverage: Coverage  # how far the nodes face the master
    lost: Bools  # (n, c) nodes that have lost a multiplier in the course of the step
    operators: MortarOperators | None = None  # of which it is made; None without a master

    @property
    def returned(self) -> Bools:
        """Nodes (n, c) that have lost a multiplier in the course of the step and got it back."""
        return self.kept & self.lost


def check_coupling(name: str, found: object, sides: Sides, pattern: Pattern) -> None:
    """Raise a ValueError unless a coupling has the right shapes and finite values.

    Args:
        name: of the interface.
        found: what its `couple` has returned.
        sides: its surfaces.
        pattern: of Q.
    """
    if not isinstance(found, Coupling):
        raise ValueError(f"{name}: couple() returns a {type(found).__name__}: return a Coupling")
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
        "lost": (n, c),
    }
    check_shapes(f"{name}: couple() returns", found, shapes)


def create_blocks(V: fem.FunctionSpace, rows: Ints, columns: Longs) -> BlockMatrix:
    """Return a matrix of d x d blocks between nodes of V; collective.

    Args:
        V: the vector space of the displacement.
        rows: owned node (p,) of each block, local number.
        columns: node (p,) of each block, global number.
    """
    return BlockMatrix(V.mesh.comm, V.dofmap.index_map, V.dofmap.index_map_bs, rows, columns)


def create_pattern(
    sides: Sides,
    row: Ints,
    column: Longs,
    split: int,
    smooth: tuple[SmoothSide, SmoothSide] | None = None,
    nearby: tuple[SmoothSide, SmoothSide] | None = None,
) -> Pattern:
    """Return the pattern of the entries, with its matrices; see `Pattern`; collective."""
    V, rows = sides.V, sides.nodes[row]
    scalars = BlockMatrix(V.mesh.comm, V.dofmap.index_map, 1, rows, column)
    return Pattern(row, column, split, create_blocks(V, rows, column), scalars, smooth, nearby)


def with_ghosts(V: fem.FunctionSpace, owned: Bools) -> Bools:
    """Return marks of this rank's own nodes, (owned nodes,), on its ghosts, too; collective."""
    vector = la.vector(V.dofmap.index_map, 1)
    vector.array[: len(owned)] = owned
    vector.scatter_forward()
    return np.asarray(vector.array > 0)


def mark(surface: Surface) -> Bools:
    """Return which local nodes of V lie on a surface, (local nodes,); collective."""
    owned = np.zeros(surface.V.dofmap.index_map.size_local, dtype=bool)
    owned[surface.nodes[: surface.owned]] = True
    return with_ghosts(surface.V, owned)
