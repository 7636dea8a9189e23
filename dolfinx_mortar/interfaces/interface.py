# SPDX-License-Identifier: MIT
"""Interfaces between bodies: contact and mesh tying, as rows of the change of basis.

At a kept slave node j with frame R_j = (n_j, t_j, ..) the displacement is written

    u_j = R_j w_j + sum_l Q_jl u_l,      Q_jl = R_j S_j R_j^T P_jl,      P = D^-1 (M - D_removed)

where S_j = diag(1 in constrained directions): (1, 0, ..) for frictionless contact, ones for a tie.
Then w is the relative displacement in those directions, and every constraint is a bound on w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem, la
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra import triplets
from dolfinx_mortar.algebra.blocks import BlockMatrix
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.interfaces.results import NoResult, Result
from dolfinx_mortar.mortar.operators import (
    LEAST_COVERAGE,
    assemble_node_matrices,
    default_keep,
    find_segments,
    node_weights,
)
from dolfinx_mortar.mortar.pairing import Pairing, create_pairing, outside_margin
from dolfinx_mortar.mortar.surface import (
    Surface,
    check_tag,
    check_tags,
    create_surface,
    mean_facet_length,
)


@dataclass(frozen=True)
class Pattern:
    """Where an interface couples slave rows to other nodes; fixed between two searches."""

    nodes: Ints  # (n,) local indices of the slave nodes this rank owns
    row: Ints  # (e,) index into nodes of each coupling entry
    column: Longs  # (e,) global node of each coupling entry
    from_D: Ints  # positions in D's values of the leading entries (off-diagonal of D)
    from_M: Ints  # positions in M's values of the remaining entries


class Interface:
    """One pair of slave and master surfaces, marked in facet tags.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag of the side that carries the multipliers and the integration (nonmortar side).
        master: tag of the other side (mortar side).

    After a step (see the subclasses for signs): ``force``, ``moment``, ``pressure``, ``gap`` and
    ``active``.
    """

    kind: ClassVar[str] = "interface"

    force: Any = Result()  # (d,) resultant exerted on the slave side
    moment: Any = Result()  # (3,) its moment about the origin
    master_force: Any = Result()  # the same for the master side
    master_moment: Any = Result()
    pressure: Any = Result()  # Functions, which exist as soon as a problem has the interface
    gap: Any = Result()
    active: Any = Result()

    normals: Floats  # (n, d) at the owned slave nodes, without prescribed directions
    R: Floats  # (n, d, d) frames, normal first
    S: Bools  # (n, d) which directions of the frame are constrained in the change of basis
    near: Bools  # (n,) slave nodes that take part in the change of basis
    slot: Ints  # (n, d) column of R that is a prescribed Cartesian direction, else -1

    def __init__(self, facet_tags: MeshTags, *, slave: int, master: int) -> None:
        """Keep the description; surfaces are found when a problem takes the interface."""
        check_tags(facet_tags)
        for name, tag in (("slave", slave), ("master", master)):
            check_tag(name, tag)
        if slave == master:
            raise ValueError(f"slave and master are both tag {slave}: give two different tags")
        self.facet_tags, self.slave, self.master = facet_tags, slave, master
        self.bound = False

    def __repr__(self) -> str:
        """Name the kind and the tags."""
        return f"{type(self).__name__}(slave={self.slave}, master={self.master})"

    # -- set-up ----------------------------------------------------------------------------------

    def bind(self, V: fem.FunctionSpace, fixed: Bools) -> None:
        """Find the surfaces in V; collective.

        Args:
            V: the vector space of the displacement.
            fixed: (local nodes, d) True where a direction of a node is prescribed.
        """
        self.V, self.fixed = V, fixed
        vars(self).pop("force", None)  # results of an earlier problem
        self.d = V.dofmap.index_map_bs
        self.n_owned = V.dofmap.index_map.size_local
        self.n_local = self.n_owned + V.dofmap.index_map.num_ghosts
        self.slave_surface = create_surface(V, self.facet_tags, self.slave, "slave")
        self.master_surface = create_surface(V, self.facet_tags, self.master, "master")
        self.banned = np.zeros(self.n_local, dtype=bool)  # claimed by an earlier interface
        self.slave_nodes = self._mark(self.slave_surface)
        self.master_nodes = self._mark(self.master_surface)
        scalar = V.sub(0).collapse()[0]
        names = ("pressure", "gap", "active")
        self.pressure, self.gap, self.active = (fem.Function(scalar, name=n) for n in names)
        owned = self.slave_surface.owned
        self.carries: Bools = np.zeros(owned, dtype=bool)  # nodes with multiplier in the results
        self.bound = True

    def share(self, owned: Bools) -> Bools:
        """Return marks of this rank's own nodes, (owned nodes,), on its ghosts, too; collective."""
        vector = la.vector(self.V.dofmap.index_map, 1)
        vector.array[: self.n_owned] = owned
        vector.scatter_forward()
        return np.asarray(vector.array > 0)

    def _mark(self, surface: Surface) -> Bools:
        """Return which local nodes lie on a surface; collective."""
        owned = np.zeros(self.n_owned, dtype=bool)
        owned[surface.nodes[: surface.owned]] = True
        return self.share(owned)

    def search(self, u: fem.Function | None) -> None:
        """Pair slave and master facets at X + u and fix the coupling pattern; collective."""
        self.pairing: Pairing = create_pairing(
            self.V, self.slave_surface, self.master_surface, u, moving=u is not None
        )
        self.facet_length = mean_facet_length(self.slave_surface)
        nodes = self.slave_surface.nodes[: self.slave_surface.owned]
        position = np.full(self.n_owned, -1, dtype=np.int32)
        position[nodes] = np.arange(len(nodes), dtype=np.int32)
        row_D, column_D = triplets.rows_and_columns(self.pairing.D)
        row_M, column_M = triplets.rows_and_columns(self.pairing.M)
        first = self.V.dofmap.index_map.local_range[0]
        from_D = np.flatnonzero((row_D + first != column_D) & (position[row_D] >= 0))
        from_M = np.flatnonzero(position[row_M] >= 0)
        self.pattern = Pattern(
            nodes,
            np.concatenate([position[row_D[from_D]], position[row_M[from_M]]]),
            np.concatenate([column_D[from_D], column_M[from_M]]),
            from_D.astype(np.int32),
            from_M.astype(np.int32),
        )
        p = self.pattern
        self._blocks = BlockMatrix(self.V, p.nodes[p.row], p.column)
        self.Q = self._blocks.matrix
        if not hasattr(self, "near"):
            self.near = np.ones(len(nodes), dtype=bool)

    def configuration(self, u: fem.Function | None) -> fem.Function | None:
        """Return the displacement at which the interface is taken, None for X."""
        return u

    def needs_search(self, u: fem.Function | None, *, everywhere: bool) -> bool:
        """Tell whether the bodies slid out of the margin of the last search; collective.

        Args:
            u: displacement.
            everywhere: ask for all slave facets; otherwise for those at near nodes only.
        """
        if everywhere:
            return outside_margin(self.pairing, u)
        near = np.zeros(self.n_owned, dtype=bool)
        near[self.pattern.nodes] = self.near
        surface = self.slave_surface
        among = self.share(near)[surface.nodes][surface.facets].any(axis=1)
        return outside_margin(self.pairing, u, among)

    # -- geometry --------------------------------------------------------------------------------

    def update(self, u: fem.Function | None) -> None:
        """Rebuild segments, D, M, frames and Q from X + u on the fixed pattern; collective."""
        segments, normals = find_segments(self.pairing, u)
        covered, tributary = node_weights(self.pairing, segments)
        nodes = self.slave_surface.nodes
        free = normals * ~self.fixed[nodes]
        left = np.linalg.norm(free, axis=1)
        allowed = self._allowed(nodes, left) & ~self.banned[nodes, None]
        P = self._project(segments, covered, tributary, allowed)

        direction = free / np.maximum(left, np.finfo(float).tiny)[:, None]
        own = slice(None, self.slave_surface.owned)
        self.coverage = covered[own] / tributary[own]
        self._set_frames(P, direction[own])

    def _project(
        self, segments: Segments, covered: Floats, tributary: Floats, allowed: Bools
    ) -> Floats:
        """Set kept and weight D_jj (n, c) and return P (entries, c) for c choices of kept nodes.

        Directions that may keep the same nodes, which is the rule, share one assembly.
        """
        same = (allowed == allowed[:, :1]).all(axis=0)
        differ = any_rank(self.V.mesh.comm, *~same)
        found: list[tuple[Floats, Floats]] = []
        for c in range(allowed.shape[1]):
            if c > 0 and not differ[c]:
                found.append(found[0])
                continue
            keep = default_keep(self.pairing, segments, covered, tributary, allowed[:, c])
            D, M = assemble_node_matrices(self.pairing, segments, keep)
            p = self.pattern
            weight = D.getDiagonal().array[p.nodes]
            values = -D.getValuesCSR()[2][p.from_D], M.getValuesCSR()[2][p.from_M]
            entries = np.concatenate(values)
            inverse = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0)
            found.append((entries * inverse[p.row], weight))
        self.weight = np.column_stack([weight for _, weight in found])
        self.kept = self.weight > 0
        return np.column_stack([entries for entries, _ in found])

    def _allowed(self, nodes: Ints, left: Floats) -> Bools:
        """Return (len(nodes), c): which nodes may carry a multiplier, per choice of direction."""
        raise NotImplementedError

    def _set_frames(self, P: Floats, normals: Floats) -> None:
        """Set R, slot, S at the owned slave nodes and refill Q."""
        raise NotImplementedError

    def constrained(self, v: PETSc.Vec) -> Floats:
        """Return the constrained components of the relative motion; collective."""
        return np.asarray(self.relative(v)[:, : self.kept.shape[1]][self.kept])

    def _fill(self, blocks: Floats) -> None:
        """Refill Q with (entries, d, d) blocks."""
        self.blocks = blocks
        self._blocks.fill(blocks)

    def relative(self, v: PETSc.Vec) -> Floats:
        """Return R^T (v_j - sum_l Q_jl v_l) at the owned slave nodes, (n, d); collective.

        In constrained directions this is the relative motion of the two sides, R_j^T (v_j - P v).
        """
        difference = v.array_r - (self.Q * v).array_r
        local = difference.reshape(-1, self.d)[self.pattern.nodes]
        return np.asarray(np.einsum("nij,ni->nj", self.R, local))

    def transpose(self, forces: Floats) -> Floats:
        """Return the owned nodal forces (I - Q)^T v of slave forces v (n, d); collective."""
        v, moved = self.Q.createVecLeft(), self.Q.createVecRight()
        v.array.reshape(-1, self.d)[self.pattern.nodes] = forces
        self.Q.multTranspose(v, moved)
        return np.asarray((v.array_r - moved.array_r).reshape(-1, self.d))

    # -- results ---------------------------------------------------------------------------------

    def set_resultants(self, forces: Floats, x: Floats) -> None:
        """Set the resultants from the forces that the slave nodes exert; collective.

        Args:
            forces: (n, d) at the owned slave nodes; -forces act on the slave body.
            x: (owned nodes, d) coordinates for the moments.

        ``force`` (d,) is the resultant exerted on the slave side, ``moment`` (3,) its moment about
        the origin; ``master_force`` and ``master_moment`` are those on the master side.
        """
        f, points = np.zeros((self.n_owned, 3)), np.zeros((self.n_owned, 3))
        f[:, : self.d], points[:, : self.d] = self.transpose(forces), x
        sides = [
            np.where(side[: self.n_owned, None], -f, 0.0)
            for side in (self.slave_nodes, self.master_nodes)
        ]
        self.carries = np.asarray(self.kept.any(axis=1))
        local = np.array([[s.sum(axis=0), np.cross(points, s).sum(axis=0)] for s in sides])
        total = self.V.mesh.comm.allreduce(local, op=MPI.SUM)
        self.force, self.moment = total[0, 0, : self.d], total[0, 1]
        self.master_force, self.master_moment = total[1, 0, : self.d], total[1, 1]

    def _extend(self, values: Floats, kept: npt.ArrayLike) -> Floats:
        """Give covered slave nodes without multiplier the mean of the kept ones on their facets.

        A kept node's value is a traction even if the node is partly covered, because D_jj is its
        covered weight; a removed node has handed its dual function to those neighbours. Nodes
        beyond the master, and all off the slave side, are not-a-number; (local nodes,).
        """
        vector = la.vector(self.V.dofmap.index_map, 2)
        array = vector.array.reshape(-1, 2)
        own = self.pattern.nodes
        array[own] = np.column_stack([np.where(kept, values, 0.0), kept])
        vector.scatter_forward()
        known = array.copy()
        covered = np.zeros(self.n_owned, dtype=bool)
        covered[own] = self.coverage > LEAST_COVERAGE
        facets = self.slave_surface.nodes[self.slave_surface.facets]
        array[:] = 0.0
        np.add.at(array, facets, known[facets].sum(axis=1, keepdims=True))
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
        with np.errstate(invalid="ignore"):
            extended = np.where(self.share(covered), array[:, 0] / array[:, 1], np.nan)
        return np.where(known[:, 1] > 0, known[:, 0], extended)

    def gather(self, u: fem.Function) -> dict[str, Floats]:
        """Return the slave nodes of all ranks on every rank; collective.

        Returns:
            "X" (n, d) reference and "x" (n, d) current coordinates at u, "pressure", "gap" and
            "active" (n,), ordered by X.

        Raises:
            NoResult: before the first step.
        """
        if "force" not in vars(self):
            raise NoResult(self, "nodal results")
        own = self.pattern.nodes
        X = self.V.tabulate_dof_coordinates()[own, : self.d]
        columns = [X, X + u.x.array.reshape(-1, self.d)[own]]
        columns += [f.x.array[own, None] for f in (self.pressure, self.gap, self.active)]
        table = np.concatenate(self.V.mesh.comm.allgather(np.hstack(columns)))
        table = table[np.lexsort(table[:, : self.d].T[::-1])]
        parts = np.split(table, [self.d, 2 * self.d], axis=1)
        names = ("pressure", "gap", "active")
        return {"X": parts[0], "x": parts[1]} | dict(zip(names, parts[2].T, strict=True))
