# SPDX-License-Identifier: MIT
"""An interface in one configuration: constraints, active nodes, results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import la
from dolfinx_mortar.algebra.parallel import any_rank, maximum, ratio
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, TINY, Actives, Bools, Floats, Ints
from dolfinx_mortar.common.spaces import with_ghosts
from dolfinx_mortar.interfaces.constraints import ROOM, SlipLimits
from dolfinx_mortar.interfaces.coupling import CoupledSides, relative_motions
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.results import Resultants
from dolfinx_mortar.interfaces.slip_partners import Partners, ToolPartners, partners_on_master
from dolfinx_mortar.mortar.surface import accumulate, mean_facet_length

# Round bodies that overlap by delta touch where they overlap by half of it (Hertz: a^2 = R delta).
OVERLAP = 0.5


@dataclass(frozen=True)
class Link(CoupledSides):
    """An interface with the results of search and update."""

    interface: Interface

    @property
    def acts_openly(self) -> bool:
        """Whether it also acts at open nodes: a tie, or given friction."""
        law = self.interface.law
        return not self.unilateral or (law is not None and not law.by_pressure)

    def partners(self, x: PETSc.Vec, *, frozen: bool) -> Partners | None:
        """Slip partners at committed positions x (n,), None for the present P; collective."""
        if self.interface.law is None:
            return None
        if (tool := self.interface.tool) is not None:
            return ToolPartners.create(self, x, tool, frozen=frozen)
        return None if frozen or self.pairing is None else partners_on_master(self, x)

    @property
    def prescribed(self) -> Bools:
        """Slave nodes (n,) without multiplier because of Dirichlet data."""
        kept, coverage = self.coupling.kept.any(axis=1), self.coupling.coverage
        left_out = coverage.faces & ~kept & ~coverage.weightless
        return left_out & self.sides.fixed[self.nodes].any(axis=1)

    def prescribed_facets(self) -> Bools:
        """Slave facets (m,) with such nodes only; collective."""
        marks = self.with_ghosts(self.prescribed)
        return np.asarray((marks > 0.0)[self.sides.slave.facets].all(axis=1))

    def with_ghosts(self, values: npt.NDArray[Any]) -> Floats:
        """Values (n,) or (n, c) of slave nodes, also at ghosts; collective."""
        slave = self.sides.slave
        local = np.zeros((len(slave.nodes), *values.shape[1:]))
        local[: slave.owned] = values
        return accumulate(slave, local)

    def slip_limits(
        self, limit: Floats, moved: PETSc.Vec, partner: Partners | None, sliding: Floats | None
    ) -> SlipLimits:
        """Limits of friction, see `InterfaceSystem.slip_limits`; collective."""
        law = self.interface.law
        assert law is not None
        slip = self.relative(moved) if partner is None else partner.slip(self, moved)
        on = self.constrained[:, 0]
        nodes, some, d = self.nodes[on], self.constrained[on, 1:], slip.shape[1]
        normal = (d * nodes).astype(np.int32)
        tangential = np.where(some, normal[:, None] + np.arange(1, d), -1).astype(np.int32)
        values, weight, axes = limit[nodes], self.coupling.weight[on, 0], self.coupling.rows[on, 1:]
        # parts in prescribed directions
        parts, room = np.zeros((2, len(nodes), d)), 1.0
        held = self.sides.fixed[nodes].any(axis=1, keepdims=True)
        if any_rank(self.sides.V.mesh.comm, held.any())[0]:
            motion = relative_motions(self, moved)[0]
            if partner is not None:
                motion = np.where(partner.known[:, None], partner.motion(self, moved), motion)
            parts[0], parts[1] = motion[on], 0.0 if sliding is None else sliding[nodes]
            n, free = self.coupling.normals[on], axes * some[:, :, None]
            parts -= (parts * n).sum(axis=2)[:, :, None] * n
            parts -= np.einsum("mti,kmt->kmi", free, np.einsum("mti,kmi->kmt", free, parts))
            room = ROOM * mean_facet_length(self.sides.slave)
        beside, before = parts * held
        return SlipLimits(
            nodes=nodes,
            normal=normal,
            tangential=tangential,
            axes=axes,
            slip=np.where(some, slip[on, 1:], 0.0),
            coefficient=values * law.by_pressure,
            cohesion=values * weight * (not law.by_pressure),
            weight=weight,
            beside=beside,
            before=before,
            room=np.full(len(nodes), room),
            opening=self.coupling.R[on, :, 0],
        )

    def acting(self, closed: Bools) -> Bools:
        """Slave nodes (n,) at which the interface acts, given closed nodes."""
        some = self.constrained.any(axis=1)
        if self.unilateral:
            return closed[self.nodes] & some
        return np.asarray(self.coupling.kept.any(axis=1))

    def apart(self) -> Floats | None:
        """Prescribed distance of tied sides (n, d), or None; collective."""
        sides = self.sides
        found = None if self.unilateral else self.interface.apart(sides.V, self.nodes)
        if found is None:
            return None
        return np.where((sides.on_slave & sides.on_master)[self.nodes, None], 0.0, found)

    def missed(self, u: PETSc.Vec) -> Floats:
        """Relative motion (n, d) of ties minus the prescribed one; collective."""
        apart = self.apart()
        return self.relative(u if apart is None else u - self.spread(apart))

    def spread(self, way: Floats) -> PETSc.Vec:
        """Motion (n, d) of the slave nodes as a displacement, 0 elsewhere."""
        v = self.Q.createVecRight()
        v.array.reshape(-1, way.shape[1])[self.nodes] = way
        return v

    def shown_gap(self, gap: Floats) -> Floats:
        """Gap (n,) for output, of ties the opening by a jump."""
        if self.unilateral:
            return gap[self.nodes]
        apart = None if self.sides.hold else self.apart()
        normals = self.coupling.normals
        return np.zeros(len(normals)) if apart is None else -(apart * normals).sum(axis=1)


def set_results_of(
    link: Link,
    reaction: Floats,
    known: Floats,
    gap: Floats,
    active: Bools,
    x: Floats,
    growth: Floats,
) -> tuple[float, float]:
    """Set resultants and Functions of an interface; return its `_balances`; collective.

    Args:
        reaction: (n, d) D_jj lambda_j in the frames, 0 in unconstrained directions.
        known: (n, d) friction vectors in prescribed directions.
        gap: (n,) nodal gaps, of ties the opening by a jump.
        active: (n,)
        x: (owned nodes, d) coordinates of the forces.
        growth: (n,) area per D_jj.
    """
    found = link.interface
    kept: Bools = np.asarray(link.coupling.kept.any(axis=1))
    D = link.coupling.weight
    weight = np.broadcast_to(D, reaction.shape)
    multiplier = np.divide(reaction, weight, out=np.zeros_like(reaction), where=weight > 0)
    forces = np.einsum("nji,nj->ni", link.coupling.rows, reaction)
    found.resultants, balances = _resultants(link, forces, known, multiplier, x)
    traction = np.einsum("nji,nj->ni", link.coupling.rows, multiplier)
    _, choices = D.shape
    if choices > 1:  # prescribed components are those of neighbours
        traction = np.nan_to_num(_extended(link, traction, link.coupling.kept)[link.nodes])
    normal = np.einsum("ni,ni->n", traction, link.coupling.normals) / np.maximum(growth, TINY)
    columns = np.column_stack([np.where(kept, normal, 0.0), gap, active])
    shown = _extended(link, columns, kept[:, None])
    shown[~link.sides.on_slave] = 0.0
    found.pressure.x.array[:], found.gap.x.array[:] = np.nan_to_num(shown[:, 0]), shown[:, 1]
    # nodes on the axis, without weight, are active with a neighbour
    around = link.coupling.coverage.weightless & (shown[link.nodes, 2] > 0.0)
    found.active.x.array[:] = 0.0
    found.active.x.array[link.nodes] = active | around
    found.active.x.scatter_forward()
    return balances


def set_sliding(
    link: Link, traction: Floats, step_slip: Floats, slip: Floats, status: Floats, energy: Floats
) -> None:
    """Set the results of friction at the owned slave nodes; collective."""
    interface, nodes = link.interface, link.nodes
    # on the axis closed nodes stick
    on = link.coupling.coverage.weightless & (interface.active.x.array[nodes] > 0.0)
    status = np.where(on, 1.0, status)
    vectors = {"traction": traction, "step_slip": step_slip}
    scalars = {"slip": slip, "status": status, "energy": energy}
    for name, at_nodes in (vectors | scalars).items():
        function = interface.nodal[name]
        function.x.array[:] = 0.0
        function.x.array.reshape(-1, *at_nodes.shape[1:])[nodes] = at_nodes
        function.x.scatter_forward()
    interface.sum_up(link.sides.V.mesh.comm, nodes)


def _resultants(
    link: Link, forces: Floats, known: Floats, multiplier: Floats, x: Floats
) -> tuple[Resultants, tuple[float, float]]:
    comm, n, d = link.sides.V.mesh.comm, link.sides.n_owned, forces.shape[1]
    f, points = np.zeros((2, n, 3)), np.zeros((n, 3))
    f[:, :, :d], points[:, :d] = link.transpose(forces), x
    if link.interface.law is not None:
        f[:, :, :d] += link.exert(known)
    if link.sides.master is None:  # the tool has the opposite forces
        f[1] = -f[0]
    local = np.array([[-s.sum(axis=0), -np.cross(points, s).sum(axis=0)] for s in f])
    total = comm.allreduce(local, op=MPI.SUM)
    rigid = link.interface.rigid
    place = np.zeros(0) if rigid is None else rigid.place()
    found = Resultants(
        force=total[0, 0, :d],
        moment=total[0, 1],
        master_force=total[1, 0, :d],
        master_moment=total[1, 1],
        multiplier=multiplier[:, 0] if link.unilateral else multiplier,
        nodes=link.nodes,
        carries=np.asarray(link.coupling.kept.any(axis=1)),
        place=np.append(place, np.zeros(3 - len(place))),
    )
    return found, _balances(comm, f, points, mean_facet_length(link.sides.slave))


def _balances(comm: MPI.Comm, f: Floats, points: Floats, h: float) -> tuple[float, float]:
    """Relative imbalances of forces (2, n, 3) and moments (theory.md, Moments); collective."""
    size = np.linalg.norm(f[0], axis=1)
    whole = comm.allreduce(np.append(size @ points, size.sum()), op=MPI.SUM)
    arms, both = points - whole[:3] / np.maximum(whole[3], TINY), f.sum(axis=0)
    scale = size @ np.linalg.norm(arms, axis=1)
    left = [*both.sum(axis=0), *np.cross(arms, both).sum(axis=0), scale]
    total = comm.allreduce(np.array(left), op=MPI.SUM)
    force, moment = (float(np.linalg.norm(v)) for v in (total[:3], total[3:6]))
    return ratio(force, whole[3]), ratio(moment, total[6] + h * whole[3])


def _extended(link: Link, values: Floats, kept: Bools) -> Floats:
    """Nodal values (local nodes, k) of those (n, k) at kept slave nodes; collective.

    Other covered nodes have the mean of kept neighbours, nodes off the master not-a-number.
    """
    sides, k = link.sides, values.shape[1]
    vector = la.vector(sides.V.dofmap.index_map, 2 * k)
    array = vector.array.reshape(-1, 2, k)
    kept = np.broadcast_to(kept, values.shape)
    array[link.nodes] = np.stack([np.where(kept, values, 0.0), kept], axis=1)
    vector.scatter_forward()
    known = array.copy()
    covered = np.zeros(sides.n_owned, dtype=bool)
    covered[link.nodes] = link.coupling.coverage.faces
    facets = sides.slave.nodes[sides.slave.facets]
    array[:] = 0.0
    np.add.at(array, facets, known[facets].sum(axis=1, keepdims=True))
    vector.scatter_reverse(la.InsertMode.add)
    vector.scatter_forward()
    with np.errstate(invalid="ignore"):
        mean = array[:, 0] / array[:, 1]
    extended = np.where(with_ghosts(sides.V, covered)[:, None], mean, np.nan)
    return np.where(known[:, 1] > 0, known[:, 0], extended)


def nodal_gaps(links: Sequence[Link], v: PETSc.Vec, n: int) -> Floats:
    """Return n_j.(P v - v_j) (owned nodes,), the gap for v = X + u, else inf; collective."""
    gap = np.full(n, np.inf)
    for link in links:
        if link.unilateral:
            normal = link.coupling.directions[:, 0]
            gap[link.nodes[normal]] = link.gaps(v)[normal]
    return gap


def predict_active(
    links: Sequence[Link], x: PETSc.Vec, n: int, bounded: Ints, facet_length: float
) -> Actives:
    """Initial active set on the owned nodes ``bounded``; collective.

    Nodes that overlap at x like round bodies in contact, or the nearest.
    """
    comm: MPI.Comm = links[0].sides.V.mesh.comm
    gap = nodal_gaps(links, x, n)
    nearest = -float(maximum(comm, -gap.min(initial=np.inf))[0])
    depth = nearest if nearest > 0.0 else OVERLAP * nearest
    level = HALF_OF_DIGITS * facet_length
    return np.asarray(gap[bounded] <= depth + level).astype(np.int8)
