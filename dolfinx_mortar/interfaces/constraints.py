# SPDX-License-Identifier: MIT
"""Bounds on unknowns of y by an interface or a support, and friction laws that limit reactions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Real
from typing import TypeAlias

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arguments import is_number
from dolfinx_mortar.arrays import ROUND_OFF, Bools, Floats, Ints
from dolfinx_mortar.spaces import check_nodal


@dataclass(frozen=True)
class Constraints:
    """Bounds on increments of unknowns y, of u = T y, in this rank's numbering.

    The problem, the QP and the certificate know constraints by their bounds only: contact has an
    upper one, tying and Dirichlet data have two that are equal.
    """

    dofs: Ints  # (k,) owned unknowns of y, each once
    lower: Floats  # (k,) -inf where there is none
    upper: Floats  # (k,) inf where there is none
    weight: Floats  # (k,) D_jj: reaction = weight * multiplier

    @property
    def equal(self) -> Bools:
        """Which unknowns have no freedom left, (k,)."""
        return np.asarray(self.lower == self.upper)

    @property
    def scale(self) -> float:
        """The largest distance that an equality still asks for; on this rank."""
        return float(np.abs(self.upper[self.equal]).max(initial=0.0))

    def select(self, mask: Bools) -> Constraints:
        """Return some of the constraints."""
        return Constraints(self.dofs[mask], self.lower[mask], self.upper[mask], self.weight[mask])


def check_shapes(
    name: str, found: object, shapes: Mapping[str, tuple[int, ...]], *, infinite: bool = False
) -> None:
    """Raise a ValueError unless the arrays of a record have their shapes and no NaN.

    Args:
        shapes: of its fields, by name.
        infinite: whether values may be infinite.
    """
    for field, shape in shapes.items():
        values = np.asarray(getattr(found, field))
        if values.shape != shape:
            raise ValueError(f"{name} {field} of shape {values.shape}: it must be {shape}")
        if not np.isfinite(values).all() and (not infinite or np.isnan(values).any()):
            raise ValueError(f"{name} {field} with NaN{'' if infinite else ' or infinity'}")


def check_constraints(name: str, found: Constraints, nodes: Ints, directions: Bools) -> None:
    """Raise a ValueError unless bounds can be those of an interface.

    Args:
        nodes: (n,) owned slave nodes.
        directions: (n, d) which directions of the frames are constrained.
    """
    shape = np.shape(found.dofs)[:1]
    check_shapes(name, found, {"dofs": shape, "weight": shape})
    check_shapes(name, found, {"lower": shape, "upper": shape}, infinite=True)
    d = directions.shape[1]
    known = (d * nodes[:, None] + np.arange(d))[directions]
    if len(np.unique(found.dofs)) < len(found.dofs) or not np.isin(found.dofs, known).all():
        raise ValueError(
            f"{name} dofs that are no unknowns of the constrained directions, or twice the same: "
            "give d * node + direction, each once"
        )
    if (found.lower > found.upper).any() or (found.weight <= 0.0).any():
        raise ValueError(f"{name} lower > upper or a weight that is not positive")


def equalities(dofs: Ints, values: Floats, weight: Floats | None = None) -> Constraints:
    """Return the constraints y = values.

    >>> equalities(np.array([4], dtype=np.int32), np.array([0.5])).equal.tolist()
    [True]
    """
    weight = np.ones(len(dofs)) if weight is None else weight
    return Constraints(dofs.astype(np.int32), values, values, weight)


def upper_bounds(nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
    """Return w_n <= gap; see `Interface.constraints` for the arguments."""
    on = directions[:, 0]
    gap = -slip[on, 0]
    dofs = (directions.shape[1] * nodes[on]).astype(np.int32)
    return Constraints(dofs, np.full(len(gap), -np.inf), gap, D[on, 0])


def join(parts: Sequence[Constraints]) -> Constraints:
    """Return the constraints of all parts."""
    columns = ([p.dofs, p.lower, p.upper, p.weight] for p in parts)
    dofs, lower, upper, weight = (np.concatenate(c) for c in zip(*columns, strict=True))
    return Constraints(dofs.astype(np.int32), lower, upper, weight)


# Slip, as a part of a facet, over which friction grows at a node whose slip is prescribed: stick
# would be a constraint of the master. So it sticks like a spring of the stiffness mu p / ROOM over
# the facet, little beside the E of the bodies: else friction that is known from the last iterate
# would not converge (pressures of E / 200, mu = .3: a factor of .1 an iteration, .35 with .01).
ROOM = 0.05


@dataclass(frozen=True)
class SlipLimits:
    """Limits of the tangential reactions at nodes of contacts with friction.

    |z_t| <= coefficient z_n + cohesion where the contact is closed, in this rank's numbering.

    In directions that are prescribed there is no unknown for z_t, but the slip s_e is known. There
    a share of the limit acts, that of Coulomb's law with the elastic slip a,

        q / max(|q + s_t / a|, 1),     q = (share at the last commit) + s_e / a,

    and what it leaves of the limit is that of the tangential unknowns.
    """

    nodes: Ints  # (m,) owned
    normal: Ints  # (m,) unknown w_n of y, which has a bound
    tangential: Ints  # (m, d - 1) unknowns of y, -1 where Dirichlet data leave none
    axes: Floats  # (m, d - 1, d) their directions in space
    slip: Floats  # (m, d - 1) tangential motion of the slave side since the last commit
    coefficient: Floats  # (m,) mu
    cohesion: Floats  # (m,) force, D_jj times a traction
    weight: Floats  # (m,) D_jj
    beside: Floats  # (m, d) slip in prescribed directions, a vector
    before: Floats  # (m, d) share at the last commit, a vector
    room: Floats  # (m,) a
    opening: Floats  # (m, d) motion of the node by a unit of its w_n

    @property
    def shares(self) -> Floats:
        """The parts (m, d) of the limit that act in prescribed directions, as vectors."""
        q = self.before + self.beside / self.room[:, None]
        return np.asarray(q / np.maximum(self._size(q), 1.0)[:, None])

    @property
    def slides(self) -> Bools:
        """At which nodes (m,) prescribed directions have all that is left of the limit."""
        q = self.before + self.beside / self.room[:, None]
        return np.asarray(q.any(axis=1) & (self._size(q) >= 1.0))

    def _size(self, q: Floats) -> Floats:
        return np.hypot(*(np.linalg.norm(v, axis=1) for v in (q, self.slip / self.room[:, None])))

    @property
    def left(self) -> tuple[Floats, Floats]:
        """Coefficient and cohesion (m,) of the limit for the tangential unknowns."""
        part = np.sqrt(np.maximum(1.0 - (self.shares**2).sum(axis=1), 0.0))
        return self.coefficient * part, self.cohesion * part

    @property
    def wedging(self) -> Floats:
        """What the friction in prescribed directions takes of lambda_j by itself (m,), a factor."""
        return self.coefficient * np.asarray((self.opening * self.shares).sum(axis=1))

    def known(self, multipliers: Floats) -> Floats:
        """Return the reactions (m, d) in prescribed directions, given lambda_j (owned nodes,)."""
        limit = self.coefficient * self.weight * multipliers[self.nodes] + self.cohesion
        return np.asarray(limit[:, None] * self.shares)

    @property
    def some(self) -> Bools:
        """Which tangential unknowns (m, d - 1) there are."""
        return np.asarray(self.tangential >= 0)

    def along(self, vectors: Floats) -> Floats:
        """Return the tangential components (m, d - 1) of vectors (m, d)."""
        return np.asarray(np.where(self.some, np.einsum("mti,mi->mt", self.axes, vectors), 0.0))

    def vectors(self, parts: Floats) -> Floats:
        """Return vectors (m, d) of tangential components (m, d - 1)."""
        return np.asarray(np.einsum("mti,mt->mi", self.axes, parts))


def join_limits(parts: Sequence[SlipLimits]) -> SlipLimits:
    """Return the limits of all parts, of one at least."""
    columns = (tuple(getattr(p, field.name) for field in fields(SlipLimits)) for p in parts)
    return SlipLimits(*(np.concatenate(c) for c in zip(*columns, strict=True)))


Limit: TypeAlias = float | fem.Constant | fem.Function

REMEDY = "give a number, a scalar fem.Constant, or a scalar Lagrange fem.Function"


@dataclass(frozen=True)
class FrictionLaw:
    """What limits the tangential traction tau of a closed contact with pressure p.

    Coulomb's law, "friction": abs(tau) <= mu p. Tresca's, "tresca": abs(tau) <= s.
    """

    name: str  # of the argument that gave it
    value: Limit

    @property
    def by_pressure(self) -> bool:
        """Whether the limit is a part of the pressure: else it acts at open nodes, too."""
        return self.name == "friction"

    def slip_limits(
        self, nodes: Ints, directions: Bools, frames: Floats, slip: Floats, D: Floats, limit: Floats
    ) -> SlipLimits:
        """Return the limits of tangential reactions.

        Args:
            nodes: (n,) owned slave nodes.
            directions: (n, d) which directions of the frames are constrained, the normal first.
            frames: (n, d, d) of which rows are the directions.
            slip: (n, d) relative motion since the last commit, in the frames.
            D: (n, c) weights.
            limit: (owned nodes,) mu or s.
        """
        on = directions[:, 0]
        some, d = directions[on, 1:], directions.shape[1]
        normal = (d * nodes[on]).astype(np.int32)
        tangential = np.where(some, normal[:, None] + np.arange(1, d), -1).astype(np.int32)
        values, weight, none = limit[nodes[on]], D[on, 0], np.zeros((len(normal), d))
        return SlipLimits(
            nodes=nodes[on],
            normal=normal,
            tangential=tangential,
            axes=frames[on, 1:],
            slip=np.where(some, slip[on, 1:], 0.0),
            coefficient=values if self.by_pressure else np.zeros_like(values),
            cohesion=np.zeros_like(values) if self.by_pressure else values * weight,
            weight=weight,
            beside=none,
            before=none,
            room=np.ones_like(values),
            opening=none,
        )

    def values(self, scalar: fem.FunctionSpace) -> Floats:
        """Return the present values at the owned nodes of a scalar space; collective.

        Raises:
            ValueError: on all ranks, for values that are negative or not finite.
        """
        comm, n = scalar.mesh.comm, scalar.dofmap.index_map.size_local
        if isinstance(self.value, fem.Function):
            self.value.x.scatter_forward()  # a node may have its value from a cell of ghosts
            at_nodes = fem.Function(scalar)
            at_nodes.interpolate(self.value)
            values = np.asarray(at_nodes.x.array[:n], dtype=np.float64)
            largest = maximum(comm, np.abs(values).max(initial=0.0))[0]
            # interpolation from another degree leaves the round-off of a zero
            none = np.isfinite(values) & (values < 0.0) & (values >= -ROUND_OFF * largest)
            values[none] = 0.0
        else:
            number = float(np.asarray(getattr(self.value, "value", self.value)).reshape(()))
            values = np.full(n, number)
        bad = ~(np.isfinite(values) & (values >= 0.0))
        if any_rank(comm, bad.any())[0]:
            what = f"{float(values[bad][0]):g} somewhere" if bad.any() else "so on another rank"
            raise ValueError(f"{self.name} is {what}: every value has to be finite and >= 0")
        return values


def create_law(friction: Limit | None, tresca: Limit | None) -> FrictionLaw | None:
    """Return the law of two arguments, None for neither and for the number 0.

    Raises:
        ValueError: for both, and for values that are no limits.
    """
    if friction is not None and tresca is not None:
        raise ValueError(
            f"friction is {friction!r} and tresca is {tresca!r}: give one of the two, a "
            "coefficient of the pressure or a traction"
        )
    name, value = ("friction", friction) if tresca is None else ("tresca", tresca)
    if value is None:
        return None
    if isinstance(value, Real) and not isinstance(value, bool):
        if not (is_number(value) and value >= 0.0):
            raise ValueError(f"{name} is {value!r}: it has to be finite and >= 0")
        return FrictionLaw(name, float(value)) if value > 0.0 else None
    if isinstance(value, fem.Function):
        check_nodal(name, value, (), REMEDY)
    elif not isinstance(value, fem.Constant):
        raise ValueError(f"{name} is {value!r}: {REMEDY}")
    if value.ufl_shape != () or not np.issubdtype(_dtype(value), np.floating):
        raise ValueError(f"{name} has shape {value.ufl_shape} and type {_dtype(value)}: {REMEDY}")
    return FrictionLaw(name, value)


def _dtype(value: fem.Function | fem.Constant) -> np.dtype:
    array = value.x.array if isinstance(value, fem.Function) else value.value
    return np.asarray(array).dtype
