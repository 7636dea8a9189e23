# SPDX-License-Identifier: MIT
"""Pretension of a bolt cut by a tie: an unknown overlap s with given conjugate force F.

The tie constrains w_j = jump_j + e_j s, e_j being n without directions with Dirichlet data and
shares of nodes without multiplier; sum_j e_j . r_j = F for its reactions (theory.md, Pretension).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.geometry.facets import area_vectors, tributary_weights
from dolfinx_mortar.interfaces.coupling import Sides
from dolfinx_mortar.mortar.surface import Surface, facets_at

Direction = Sequence[float] | Floats | None
"""Components of a vector of any length."""

# Least cosine with the outward normal: below is shear, or inward if negative.
ALONG = 0.45
# Least mean unit normal of a side that is not around a shank, sin(a) / a for an arc of angle 2 a.
AROUND = 0.1


@dataclass(frozen=True)
class Bolt:
    """Overlap s of a tie along n as an unknown with given conjugate force F."""

    axis: Floats  # (d,) n
    force: Callable[[], float]
    tighten: Callable[[Floats], None]
    overlap: Floats  # (d,)
    name: str

    holds = True
    names = ("pretension",)
    remedy = (
        "supports, ties or contacts have to hold both ends of the bolt along tie.direction, which "
        "points out of the slave side for tension, or the force is too large for the stiffness of "
        "the bolt (check units of both); pretension=None holds the jump"
    )

    def loads(self) -> Floats:
        """The force F (1,)."""
        return np.array([self.force()])

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """See `RigidBody`: n at each node (1, n, d)."""
        return np.tile(self.axis, (1, len(X), 1))

    def curve(self, X: Floats, amounts: Floats) -> Floats:
        """Zero: n is fixed."""
        return np.zeros_like(X)

    def move(self, amounts: Floats) -> None:
        """Add s (1,)."""
        self.tighten(amounts[0] * self.axis)

    def check(self, sides: Sides, largest: float) -> None:
        """Raise a ValueError where the sides cannot overlap; collective."""
        common = (sides.on_slave & sides.on_master)[: sides.n_owned]
        count = sides.V.mesh.comm.allreduce(int(common.sum()), op=MPI.SUM)
        if count:
            raise ValueError(
                f"pretension: both sides of {self.name} have {count} nodes in common, where they "
                "cannot overlap: cut the bolt all through its section"
            )
        if largest == 0.0:
            raise ValueError(
                f"pretension: no slave node of {self.name} carries a multiplier along the "
                f"direction {self.axis.tolist()}: check the tags, the Dirichlet data at its nodes, "
                "and other interfaces that claim them"
            )


def find_axis(normal: Floats, direction: Direction, who: str) -> Floats:
    """Unit vector (d,) of a pretension, the mean normal for None.

    Raises:
        ValueError: if the direction points into the slave side, or is missing.
    """
    length = float(np.linalg.norm(normal))
    around = length <= AROUND
    if direction is None:
        if around:
            raise ValueError(
                f"direction is None, but the slave side of {who} has no mean normal, as its "
                "normals point all around: give the axis of the bolt"
            )
        return np.asarray(normal / length)
    axis = np.array(direction, dtype=float)
    if not around and float(axis @ normal) < -ALONG * length:
        raise ValueError(
            f"direction is {axis.tolist()}, which points from the master side into the slave side: "
            "turn it round (out of the slave side) for tension; to push the sides apart, give a "
            "negative force then"
        )
    return axis


def describe_shear(normal: Floats, axis: Floats, who: str) -> str:
    """Warning if n runs along the cut, or ""."""
    length, along = float(np.linalg.norm(normal)), float(axis @ normal)
    if length <= AROUND or along >= ALONG * length:
        return ""
    return (
        f"direction is {axis.tolist()}, whose cosine with the mean normal out of the slave side of "
        f"{who} is {round(along / length, 3) + 0.0:g}: the sides slip along each other rather than "
        "overlap, and the force is shear. For tension give the axis of the bolt, out of the slave "
        "side"
    )


def mean_normal(slave: Surface) -> Floats:
    """Mean outward unit normal (d,) of a side at X; collective."""
    found = facets_at(slave, slave.X)
    own = np.append(area_vectors(found).sum(axis=0), tributary_weights(found).sum())
    total = slave.V.mesh.comm.allreduce(own, op=MPI.SUM)
    return np.asarray(total[:-1] / total[-1])
