# SPDX-License-Identifier: MIT
"""What a search and an update find for one interface: records, made anew and never changed.

At a kept slave node j with frame R_j = (n_j, t_j, ..) the displacement is written

    u_j = R_j w_j + sum_l Q_jl u_l,      Q_jl = R_j S_j R_j^T P_jl,      P = D^-1 (M - D_other)

with D on the diagonal, and D_other what it has besides: columns of removed nodes, and of the ends
on which the middles of six-node triangles depend (`dolfinx_mortar.mortar.dual`). Here S_j = diag(1
in constrained directions); for ties of smooth surfaces P_jl I is completed by the motions
D_jj^-1 int Phi_j A_l of `dolfinx_mortar.geometry.offset_vectors`. Then w is the relative
displacement of the two sides in those directions, and every constraint is a bound on w.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra import triplets
from dolfinx_mortar.algebra.blocks import BlockMatrix
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.geometry.tolerances import ROUND_OFF, TINY
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.mortar.curvature_correction import (
    SmoothSide,
    find_smooth_sides,
    point_heights,
    point_motions,
)
from dolfinx_mortar.mortar.edges import edge_normals, find_edges, open_duals
from dolfinx_mortar.mortar.operators import (
    Coverage,
    assemble_motions,
    assemble_node_matrices,
    default_keep,
    drop_far,
    find_coverage,
    find_segments,
    integrate_values,
    node_weights,
    weighted_duals,
)
from dolfinx_mortar.mortar.pairing import Pairing, Weight, create_pairing, outside_margin
from dolfinx_mortar.mortar.surface import Surface, accumulate, create_surface, dependent_nodes


@dataclass(frozen=True)
class Sides:
    """The two surfaces of an interface in the space of the displacement."""

    V: fem.FunctionSpace
    slave: Surface
    master: Surface
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


@dataclass(frozen=True)
class Pattern:
    """Where an interface couples slave rows to other nodes; fixed between two searches."""

    row: Ints  # (e,) index into the owned slave nodes
    column: Longs  # (e,) global node
    from_D: Ints  # positions in D's values of the leading entries (off-diagonal of D)
    from_M: Ints  # positions in M's values of the remaining entries
    blocks: BlockMatrix  # room for Q
    scalars: BlockMatrix  # room for P
    smooth: tuple[SmoothSide, SmoothSide] | None  # where facets stand for them


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
    heights: Floats  # (n,) by how much the smooth surfaces are nearer than the facets; 0 for these
    coverage: Coverage  # how far the nodes face the master
    lost: Bools  # (n, c) nodes that have lost a multiplier in the course of the step
    segments: Segments

    @property
    def returned(self) -> Bools:
        """Nodes (n, c) that have lost a multiplier in the course of the step and got it back."""
        return self.kept & self.lost


@dataclass(frozen=True)
class Link:
    """An interface with what a search and an update have found for it."""

    interface: Interface
    sides: Sides
    pairing: Pairing
    pattern: Pattern
    coupling: Coupling
    near: Bools  # (n,) slave nodes that take part in the change of basis
    banned: Bools  # (local nodes,) slave nodes that another interface has

    @property
    def nodes(self) -> Ints:
        """Local numbers (n,) of the slave nodes that this rank owns."""
        return self.sides.nodes

    @property
    def Q(self) -> PETSc.Mat:
        """The matrix Q, in room that it shares with other configurations of the same pattern."""
        return self.pattern.blocks.of(self.coupling.blocks)

    @property
    def constrained(self) -> Bools:
        """Which directions of the frames (n, d) are constrained in the change of basis."""
        return np.asarray(self.coupling.directions & self.near[:, None])

    @property
    def slot(self) -> Ints:
        """Column of the frames in use (n, d) that is a prescribed Cartesian direction, else -1."""
        axes = np.arange(self.coupling.slot.shape[1], dtype=np.int32)
        left = np.where(self.sides.fixed[self.nodes], axes, -1)
        bound = np.asarray(self.constrained.any(axis=1))[:, None]
        return np.where(bound, self.coupling.slot, left).astype(np.int32)

    @property
    def frames(self) -> Floats:
        """Frames in use (n, d, d): Cartesian ones where nothing is bound."""
        bound = np.asarray(self.constrained.any(axis=1))[:, None, None]
        return np.where(bound, self.coupling.R, np.eye(self.coupling.R.shape[1]))

    def relative(self, v: PETSc.Vec) -> Floats:
        """Return R^T (v_j - sum_l Q_jl v_l) at the owned slave nodes, (n, d); collective.

        In constrained directions this is the relative motion of the two sides, R_j^T (v_j - P v).
        """
        difference = v.array_r - (self.Q * v).array_r
        local = difference.reshape(-1, self.coupling.R.shape[1])[self.nodes]
        return np.asarray(np.einsum("nij,ni->nj", self.coupling.R, local))

    def gaps(self, v: PETSc.Vec) -> Floats:
        """Return n_j.(P v - v_j) - h_j at the owned slave nodes (n,) for v = X + u; collective.

        The distance to the master along the normal; h_j the mean height of smooth surfaces.
        """
        normals = self.coupling.normals
        moved = (self.Q * v).array_r - v.array_r
        along = (moved.reshape(-1, normals.shape[1])[self.nodes] * normals).sum(axis=1)
        return np.asarray(along - self.coupling.heights)

    def constrained_motion(self, v: PETSc.Vec) -> Floats:
        """Return the constrained components of the relative motion, near or far; collective."""
        return np.asarray(self.relative(v)[self.coupling.directions])

    def transpose(self, forces: Floats) -> tuple[Floats, Floats]:
        """Return the owned nodal forces (I - Q)^T v of slave forces v (n, d); collective.

        Those on the slave side (of I and D) and those on the master side (of M), which meet at
        nodes of both. Their sum is (I - Q)^T v.
        """
        p, d = self.pattern, forces.shape[1]
        dofs = (d * p.column[:, None] + np.arange(d)).astype(PETSc.IntType)
        moved = -np.einsum("eij,ei->ej", self.coupling.blocks, forces[p.row])
        sides = []
        for part in (slice(None, p.from_D.size), slice(p.from_D.size, None)):
            side = self.Q.createVecRight()
            side.setValues(dofs[part].ravel(), moved[part].ravel(), PETSc.InsertMode.ADD_VALUES)
            side.assemble()
            sides.append(np.array(side.array_r).reshape(-1, d))
        slave, master = sides
        slave[self.nodes] += forces
        return slave, master


def create_blocks(V: fem.FunctionSpace, rows: Ints, columns: Longs) -> BlockMatrix:
    """Return a matrix of d x d blocks between nodes of V; collective.

    Args:
        V: the vector space of the displacement.
        rows: owned node (p,) of each block, local number.
        columns: node (p,) of each block, global number.
    """
    return BlockMatrix(V.mesh.comm, V.dofmap.index_map, V.dofmap.index_map_bs, rows, columns)


def with_ghosts(V: fem.FunctionSpace, owned: Bools) -> Bools:
    """Return marks of this rank's own nodes, (owned nodes,), on its ghosts, too; collective."""
    vector = la.vector(V.dofmap.index_map, 1)
    vector.array[: len(owned)] = owned
    vector.scatter_forward()
    return np.asarray(vector.array > 0)


def find_sides(
    interface: Interface, V: fem.FunctionSpace, fixed: Bools, weight: Weight | None = None
) -> Sides:
    """Find the surfaces of an interface in V; collective.

    Args:
        interface: the description.
        V: the vector space of the displacement.
        fixed: (local nodes, d) True where a direction of a node is prescribed.
        weight: factor of all integrals over the interface, 1 if not given.
    """
    slave = create_surface(V, interface.facet_tags, interface.slave, "slave")
    master = create_surface(V, interface.facet_tags, interface.master, "master")
    dependent = dependent_nodes(slave)[: slave.owned]
    edges = find_edges(slave, interface.feature_angle) if interface.one_sided else None
    return Sides(V, slave, master, _mark(slave), _mark(master), fixed, dependent, edges, weight)


def _mark(surface: Surface) -> Bools:
    """Return which local nodes lie on a surface; collective."""
    owned = np.zeros(surface.V.dofmap.index_map.size_local, dtype=bool)
    owned[surface.nodes[: surface.owned]] = True
    return with_ghosts(surface.V, owned)


def pair(
    interface: Interface,
    sides: Sides,
    u: fem.Function | None,
    *,
    again: bool,
    room: tuple[Pairing, Pattern] | None = None,
) -> tuple[Pairing, Pattern]:
    """Pair slave and master facets at X + u and fix the coupling pattern; collective.

    Args:
        interface: the description.
        sides: its surfaces.
        u: displacement, None for X.
        again: sides that have faced each other once may turn away; at first that is an error.
        room: of an earlier search, whose matrices serve once more where the pairs are the same.
    """
    surfaces = sides.slave, sides.master
    moving, earlier = u is not None, None if room is None else room[0]
    options = {"moving": moving, "again": again, "weight": sides.weight, "room": earlier}
    pairing = create_pairing(sides.V, *surfaces, u, **options)
    if room is not None and pairing.D is room[0].D:
        return pairing, room[1]
    nodes = sides.nodes
    position = np.full(sides.n_owned, -1, dtype=np.int32)
    position[nodes] = np.arange(len(nodes), dtype=np.int32)
    row_D, column_D = triplets.rows_and_columns(pairing.D)
    row_M, column_M = triplets.rows_and_columns(pairing.M)
    first = sides.V.dofmap.index_map.local_range[0]
    from_D = np.flatnonzero((row_D + first != column_D) & (position[row_D] >= 0))
    from_M = np.flatnonzero(position[row_M] >= 0)
    row = np.concatenate([position[row_D[from_D]], position[row_M[from_M]]])
    column = np.concatenate([column_D[from_D], column_M[from_M]])
    blocks = create_blocks(sides.V, nodes[row], column)
    scalars = BlockMatrix(sides.V.mesh.comm, sides.V.dofmap.index_map, 1, nodes[row], column)
    parts = from_D.astype(np.int32), from_M.astype(np.int32)
    smooth = None
    if interface.smooth and not sides.slave.curved:
        smooth = find_smooth_sides(pairing, sides.fixed, interface.feature_angle)
    return pairing, Pattern(row, column, *parts, blocks, scalars, smooth)


def has_slid(link: Link, u: fem.Function | None, *, everywhere: bool) -> bool:
    """Tell whether the bodies slid out of the margin of the last search; collective.

    Args:
        link: the interface and its pairing.
        u: displacement.
        everywhere: ask for all slave facets; otherwise for those at near nodes only.
    """
    if everywhere:
        return outside_margin(link.pairing, u)
    near = np.zeros(link.sides.n_owned, dtype=bool)
    near[link.nodes] = link.near
    surface = link.sides.slave
    among = with_ghosts(link.sides.V, near)[surface.nodes][surface.facets].any(axis=1)
    return outside_margin(link.pairing, u, among)


def find_partners(
    interface: Interface, pairing: Pairing, u: fem.Function | None
) -> tuple[Segments, Floats]:
    """Return the segments that an interface couples at X + u, and the slave normals; collective."""
    segments, normals = find_segments(pairing, u)
    if not interface.one_sided:  # contacts meet from any distance
        segments = drop_far(pairing, segments, u, interface.reach)
    return segments, normals


def _integrate(
    pairing: Pairing, pattern: Pattern, segments: Segments, keep: Bools, Phi: Floats
) -> tuple[Floats, Floats]:
    """Return P (e,) = D^-1 (M - D_other) on the pattern and the weights D_jj (n,); collective."""
    D, M = assemble_node_matrices(pairing, segments, keep, Phi)
    weight = D.getDiagonal().array[pairing.slave.nodes[: pairing.slave.owned]]
    values = -D.getValuesCSR()[2][pattern.from_D], M.getValuesCSR()[2][pattern.from_M]
    return np.concatenate(values) * _inverse(weight)[pattern.row], weight


def _inverse(weight: Floats) -> Floats:
    """Return 1 / D_jj, zero where that is: at nodes without multiplier."""
    return np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0)


def couple(
    interface: Interface,
    sides: Sides,
    pairing: Pairing,
    pattern: Pattern,
    banned: Bools,
    u: fem.Function | None,
    before: Coupling | None = None,
) -> Coupling:
    """Integrate D and M at X + u on the fixed pattern; collective.

    Args:
        interface: what is constrained.
        sides: its surfaces.
        pairing: candidate pairs.
        pattern: where D and M couple nodes.
        banned: (local nodes,) slave nodes that may not carry a multiplier.
        u: displacement, None for X.
        before: of the last geometry of the step; in its first one none.
    """
    segments, normals = find_partners(interface, pairing, u)
    if sides.edges is not None:
        normals = edge_normals(pairing, segments, u, normals, sides.edges)
    covered, tributary = node_weights(pairing, segments)
    nodes, own = sides.slave.nodes, slice(None, sides.slave.owned)
    free = normals * ~sides.fixed[nodes]
    left = np.linalg.norm(free, axis=1)
    allowed = interface.may_carry(left, sides.fixed[nodes]) & ~banned[nodes, None]
    differ = any_rank(sides.V.mesh.comm, *(allowed != allowed[:, :1]).any(axis=0))
    # choices that keep the same nodes share one assembly
    choices = [c if differ[c] else 0 for c in range(allowed.shape[1])]
    keep = {
        c: default_keep(
            pairing, segments, covered, tributary, allowed[:, c], _returned(sides, before, c)
        )
        for c in sorted(set(choices))
    }
    Phi = {c: weighted_duals(pairing, segments, keep[c]) for c in keep}
    if sides.edges is not None:
        Phi[0] = open_duals(pairing, segments, u, Phi[0], keep[0], sides.edges, banned[nodes])
    heights: Floats = np.zeros(sides.slave.owned)
    motions: Floats | None = None
    if pattern.smooth is not None and not interface.one_sided:
        at = point_motions(segments, pattern.smooth)
        rows = [Phi[c] for c in choices]
        motions = assemble_motions(pairing, segments, rows, at)[pattern.from_M]
    found = {c: _integrate(pairing, pattern, segments, keep[c], Phi[c]) for c in keep}
    P, weights = (np.column_stack([found[c][i] for c in choices]) for i in range(2))
    if pattern.smooth is not None and interface.one_sided:
        at_points = point_heights(pairing, segments, u, pattern.smooth)
        heights = _heights(pairing, segments, Phi[0], weights[:, 0], at_points)
    kept = weights > 0
    lost = np.zeros_like(kept) if before is None else before.lost | (before.kept & ~kept)
    some = (left > ROUND_OFF)[:, None]  # of less only round-off has a direction
    direction = np.where(some, free / np.maximum(left, TINY)[:, None], 0.0)
    frame = interface.frame(direction[own], kept, sides.fixed[sides.nodes])
    blocks = interface.blocks(P, frame, pattern.row)
    if motions is not None:
        of_master = slice(pattern.from_D.size, None)
        blocks[of_master] += motions * _inverse(weights)[pattern.row[of_master], :, None]
    blocks.flags.writeable = False
    return Coupling(
        blocks=blocks,
        P=P,
        R=frame.R,
        slot=frame.slot,
        directions=frame.directions,
        kept=kept,
        weight=weights,
        normals=frame.normals,
        heights=heights,
        coverage=find_coverage(pairing, segments, covered, tributary),
        lost=lost,
        segments=segments,
    )


def stand_off(link: Link, u: fem.Function | None, smooth: tuple[SmoothSide, SmoothSide]) -> Floats:
    """Return the heights (n,) that smooth surfaces would have at the slave nodes; collective.

    By so much the gap between the facets is too large (or, where sides are hollow, too small).

    Args:
        link: the interface, coupled at X + u.
        u: displacement, None for X.
        smooth: the smooth surfaces at X.
    """
    pairing, segments = link.pairing, link.coupling.segments
    Phi = weighted_duals(pairing, segments, _everywhere(link.sides, link.coupling.kept[:, 0]))
    at_points = point_heights(pairing, segments, u, smooth)
    return _heights(pairing, segments, Phi, link.coupling.weight[:, 0], at_points)


def _returned(sides: Sides, before: Coupling | None, choice: int) -> Bools | None:
    """Return which local slave nodes (n,) have returned for a choice; None if none has."""
    if before is None or not any_rank(sides.V.mesh.comm, before.returned.any())[0]:
        return None
    return _everywhere(sides, before.returned[:, choice])


def _everywhere(sides: Sides, own: Bools) -> Bools:
    """Return marks (n,) of all local slave nodes, of those of the owned ones; collective."""
    marks = np.zeros(len(sides.slave.nodes))
    marks[: sides.slave.owned] = own
    return np.asarray(accumulate(sides.slave, marks) > 0)


def _heights(
    pairing: Pairing, segments: Segments, Phi: Floats, weight: Floats, at_points: Floats
) -> Floats:
    """Return int Phi_j h / D_jj (n,) at the owned slave nodes, of h (q,); collective.

    With D_jj in ``weight`` (n,), zero where that is.
    """
    total = integrate_values(pairing, segments, Phi, at_points)[: pairing.slave.owned]
    return np.asarray(total * _inverse(weight))


def measure_coverage(interface: Interface, pairing: Pairing, u: fem.Function | None) -> Coverage:
    """Return how far the slave nodes face the master at X + u; collective."""
    segments, _ = find_partners(interface, pairing, u)
    return find_coverage(pairing, segments, *node_weights(pairing, segments))


def restrict(link: Link, near: Bools) -> Link:
    """Let only these slave nodes, (n,), take part in the change of basis."""
    return replace(link, near=near)
