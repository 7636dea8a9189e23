# SPDX-License-Identifier: MIT
"""Bounds on unknowns of y by an interface or a support, and limits of their reactions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints


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


def check_limits(name: str, found: SlipLimits, d: int) -> None:
    """Raise a ValueError unless the arrays of `SlipLimits` fit each other, without NaN."""
    m = np.shape(found.nodes)[0] if np.ndim(found.nodes) else 0
    one: dict[str, tuple[int, ...]] = dict.fromkeys(
        ("nodes", "normal", "coefficient", "cohesion", "weight"), (m,)
    )
    more = {"tangential": (m, d - 1), "axes": (m, d - 1, d), "slip": (m, d - 1)}
    check_shapes(name, found, one | more)


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


@dataclass(frozen=True)
class SlipLimits:
    """Limits of the tangential reactions at nodes of contacts with friction.

    |z_t| <= coefficient z_n + cohesion where the contact is closed, in this rank's numbering.
    """

    nodes: Ints  # (m,) owned
    normal: Ints  # (m,) unknown w_n of y, which has a bound
    tangential: Ints  # (m, d - 1) unknowns of y, -1 where Dirichlet data leave none
    axes: Floats  # (m, d - 1, d) their directions in space
    slip: Floats  # (m, d - 1) tangential motion of the slave side since the last commit
    coefficient: Floats  # (m,) mu
    cohesion: Floats  # (m,) force, D_jj times a traction
    weight: Floats  # (m,) D_jj

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
