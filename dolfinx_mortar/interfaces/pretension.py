# SPDX-License-Identifier: MIT
"""Pretension of a bolt that is cut by a tie: an unknown overlap s, whose conjugate force is given.

The tie asks for w_j = jump_j + e_j s at its slave nodes, with e_j the part of n that node j takes:
n itself, but for directions with Dirichlet data, and for what its dual function has of nodes
without a multiplier. With the reactions r_j of the tie, virtual work gives the one equation

    sum_j e_j . r_j = F,

and the left side is ``tie.force @ n``. All w_j are known but for s, so s takes the place of one of
them in y, the pivot p, and T the column sum_j T_j e_j there: sizes and layouts stay. F does work on
s = (w_p - jump_p) / e_p, which is a linear function of u: so it acts like a pair of nodal forces,
F / e_p at node p and its negative, spread by P, on the master side. T^T takes the pair to the
entry F of s, and to nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arguments import as_numbers, is_number
from dolfinx_mortar.arrays import Floats, Ints, Longs
from dolfinx_mortar.interfaces.constraints import Constraints
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.spaces import check_real

Direction = Sequence[float] | Floats | None
"""Components of a vector of any length."""

Force = float | fem.Constant | None
"""A number, or a scalar Constant."""

# Along the outward normal of the slave side, cosine: less is shear rather than tension, or points
# into the body where it is negative. Cuts at 60 degrees to the axis are above.
ALONG = 0.45
# Mean of the unit normals of a side, length: a shorter one is that of a side around a shank. An arc
# of the angle 2 a has sin(a) / a, which is below for more than 327 of 360 degrees.
AROUND = 0.1


def check_force(value: Any) -> Any:
    """Return a pretension as it is kept; without communication.

    Raises:
        ValueError: for what is no finite number, scalar Constant or None.
    """
    if isinstance(value, fem.Constant):
        check_real("pretension", value)
        if value.value.shape == ():
            return value
    if value is None or is_number(value):
        return value
    raise ValueError(
        f"pretension is {value!r}: give a finite number or a scalar Constant, the resultant of the "
        "bolt, or None to hold the jump"
    )


def check_direction(direction: Any, d: int) -> Floats:
    """Return the unit vector (d,) of a direction; without communication.

    Raises:
        ValueError: for what has not d finite components, or only zeros.
    """
    numbers = as_numbers(direction.tolist() if isinstance(direction, np.ndarray) else direction)
    n = np.zeros(0) if numbers is None else numbers
    if n.shape != (d,) or not np.isfinite(n).all() or not n.any():
        raise ValueError(
            f"direction is {direction!r}: give {d} finite components, not all zero, along the axis "
            "of the bolt"
        )
    n = n / np.abs(n).max()  # squares of very large or small components are none
    return np.asarray(n / np.linalg.norm(n))


@dataclass(frozen=True)
class Pretension:
    """The unknown overlap s of a tie along n, in a basis y in which it has the pivot's place."""

    number: int  # of the interface
    axis: Floats  # (d,) n
    dofs: Ints  # (m,) owned unknowns of y, the w that the tie holds, in the order of constraints
    shares: Floats  # (m,) e at them
    pivot: Ints  # (1,) position of the pivot among them; (0,) on all ranks but its own
    place: int  # global number of the pivot's unknown
    share: float  # e at the pivot, on all ranks
    pair: PETSc.Vec  # (n,) nodal forces of a unit pretension, see above
    comm: MPI.Comm

    @property
    def own(self) -> Ints:
        """The unknown s (1,), its local number in y; (0,) on all ranks but its own."""
        return self.dofs[self.pivot]

    def entries(self, d: int) -> tuple[Ints, Longs, Floats]:
        """Return owned nodes (k,), global node (k,) and blocks (k, d, d) of S - I.

        S is the identity with e as the column of s, and T S the basis with the unknown s.
        """
        nodes, position = np.unique(self.dofs // d, return_inverse=True)
        column, component = divmod(self.place, d)
        blocks = np.zeros((len(nodes), d, d))
        blocks[position, self.dofs % d, component] = self.shares
        at = self.pivot
        blocks[position[at], self.dofs[at] % d, component] -= 1.0
        return nodes.astype(np.int32), np.full(len(nodes), column, dtype=np.int64), blocks

    def free(self, held: Constraints) -> tuple[Constraints, float]:
        """Return what the tie asks of all w but s, and by how much s is beyond the jump.

        Args:
            held: equalities at `dofs`, which a tie with the jump held asks for; collective.
        """
        missing = held.upper
        s = -self._of_pivot(missing) / self.share
        missing = missing + self.shares * s
        others = np.ones(len(missing), dtype=bool)
        others[self.pivot] = False
        return replace(held, lower=missing, upper=missing).select(others), s

    def missing(self, reduced: PETSc.Vec) -> float:
        """Return the pretension less the force of the tie, from T^T r; collective."""
        return self._of_pivot(reduced.array_r[self.dofs])

    def reaction(self, reduced: PETSc.Vec, force: float) -> float:
        """Return the tie's own reaction at the pivot, from T^T r with this force in r; collective.

        The entry of s is F + sum_j e_j r_j.
        """
        others = float(self.shares @ reduced.array_r[self.dofs])
        others -= float((self.shares * reduced.array_r[self.dofs])[self.pivot].sum())
        return (self.missing(reduced) - force - self._sum(others)) / self.share

    def lower(self, y: PETSc.Vec) -> None:
        """Replace w by the unknowns with s in y, in place: S^-1 y; collective."""
        s = self._of_pivot(y.array_r[self.dofs]) / self.share
        y.array[self.dofs] -= self.shares * s
        y.array[self.own] = s

    def held_motion(self, link: Link) -> Callable[[PETSc.Vec], Floats]:
        """Return the motion that the tie resists, that of all w without e s."""
        size = self._sum(float(self.shares @ self.shares))

        def motion(v: PETSc.Vec) -> Floats:
            moved = link.constrained_motion(v)
            return np.asarray(moved - self.shares * self._sum(float(self.shares @ moved)) / size)

        return motion

    def _of_pivot(self, values: Floats) -> float:
        return self._sum(float(values[self.pivot].sum()))

    def _sum(self, value: float) -> float:
        return float(self.comm.allreduce(value, op=MPI.SUM))


def find_pretensions(links: Sequence[Link]) -> list[Pretension]:
    """Return the unknowns of the ties with a pretension, in the order of the links; collective.

    Raises:
        ValueError: if a direction is needed and the sides have none, or it points into the slave
            side; if no node carries a multiplier along it; if the sides of the tie have nodes in
            common, where they cannot overlap.
    """
    found = []
    for number, link in enumerate(links):
        released = link.interface.released
        if released is not None:
            found.append(_create(number, link, find_axis(link, np.array(released))))
    return found


def find_axis(link: Link, direction: Floats) -> Floats:
    """Return the unit vector of a pretension, (d,); the mean normal for none, (0,); collective.

    Raises:
        ValueError: if the direction points into the slave side, or there is none.
    """
    normal = mean_normal(link)
    if not direction.size:
        if not normal.any():
            raise ValueError(
                f"direction is None, but the slave side of {link.interface} has no mean normal, as "
                "its normals point all around or Dirichlet data hold its nodes: give the axis of "
                "the bolt"
            )
        return normal
    if float(direction @ normal) < -ALONG:
        raise ValueError(
            f"direction is {direction.tolist()}, which points from the master side into the slave "
            "side: turn it round (out of the slave side) for tension; to push the sides apart, "
            "give a negative force then"
        )
    return direction


def describe_shear(link: Link, axis: Floats) -> str:
    """Say that n runs along the cut rather than across it; nothing where it does not; collective.

    A side around a shank has no direction of its own.
    """
    normal = mean_normal(link)
    cosine = float(axis @ normal)
    if cosine >= ALONG or not normal.any():
        return ""
    shown = np.round([cosine, *normal], 3) + 0.0  # no -0
    outward = ", ".join(f"{x:g}" for x in shown[1:])
    return (
        f"direction is {axis.tolist()}, whose cosine with the normal [{outward}] out of the slave "
        f"side of {link.interface} is {shown[0]:g}: the sides slip along each other rather than "
        "overlap, and the force is shear. For tension give the axis of the bolt, out of the slave "
        "side"
    )


def mean_normal(link: Link) -> Floats:
    """Return the mean outward unit normal (d,) of the slave side, or 0; collective."""
    comm, coupling = link.sides.V.mesh.comm, link.coupling
    weight = coupling.weight.max(axis=1, initial=0.0)[:, None]
    total = comm.allreduce((weight * coupling.normals).sum(axis=0), op=MPI.SUM)
    length, area = float(np.linalg.norm(total)), comm.allreduce(weight.sum(), op=MPI.SUM)
    return np.asarray(total / length if length > AROUND * area else 0.0 * total)


def _create(number: int, link: Link, axis: Floats) -> Pretension:
    """Return the unknown of a tie; collective."""
    sides, comm, d = link.sides, link.sides.V.mesh.comm, len(axis)
    common = (sides.on_slave & sides.on_master)[: sides.n_owned]
    count = comm.allreduce(int(common.sum()), op=MPI.SUM)
    if count:
        raise ValueError(
            f"pretension: both sides of {link.interface} have {count} nodes in common, where they "
            "cannot overlap: cut the bolt all through its section"
        )
    moved = link.Q.createVecRight()
    moved.array.reshape(-1, d)[link.nodes] = axis
    node, component = np.nonzero(link.constrained)
    dofs = (d * link.nodes[node] + component).astype(np.int32)
    shares = link.relative(moved)[node, component]
    largest = np.abs(shares).max(initial=0.0)
    most, rank = comm.allreduce((float(largest), comm.rank), op=MPI.MAXLOC)
    if most == 0.0:
        raise ValueError(
            f"pretension: no slave node of {link.interface} carries a multiplier along the "
            f"direction {axis.tolist()}: check the tags, the Dirichlet data at its nodes, and "
            "other interfaces that claim them"
        )
    mine = comm.rank == rank
    pivot = np.flatnonzero(np.abs(shares) == largest)[: int(mine)].astype(np.int32)
    first = d * sides.V.dofmap.index_map.local_range[0]
    here = (int(first + dofs[pivot[0]]), float(shares[pivot[0]])) if mine else None
    place, share = comm.bcast(here, root=rank)
    pair = _pair(link, dofs[pivot], share)
    return Pretension(number, axis, dofs, shares, pivot, place, share, pair, comm)


def _pair(link: Link, pivot: Ints, share: float) -> PETSc.Vec:
    """Return the nodal forces (n,) that do the work of a unit pretension; collective."""
    at_pivot, pair = link.Q.createVecRight(), link.Q.createVecRight()
    at_pivot.array[pivot] = 1.0 / share
    link.Q.multTranspose(at_pivot, pair)
    pair.aypx(-1.0, at_pivot)
    return pair
