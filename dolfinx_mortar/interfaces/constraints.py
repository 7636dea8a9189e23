# SPDX-License-Identifier: MIT
"""Bounds on unknowns, and friction laws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any, TypeAlias, TypeVar

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import largest, raised_together, ratio
from dolfinx_mortar.common.arguments import (
    NOT_NEGATIVE,
    NUMBER,
    Rule,
    array,
    check,
    instance,
    is_number,
)
from dolfinx_mortar.common.arrays import ROUND_OFF, Bools, Floats, Ints, place
from dolfinx_mortar.common.spaces import check_nodal, check_real
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Constraints:
    """Bounds on increments of y, in this rank's numbering."""

    dofs: Ints  # (k,) owned unknowns of y, each once
    lower: Floats  # (k,) -inf if free
    upper: Floats  # (k,) inf if free
    weight: Floats  # (k,) D_jj: reaction = weight * multiplier

    @property
    def equal(self) -> Bools:
        """Equalities (k,)."""
        return np.asarray(self.lower == self.upper)

    @property
    def scale(self) -> float:
        """Largest value of an equality on this rank."""
        return float(np.abs(self.upper[self.equal]).max(initial=0.0))

    def select(self, mask: Bools) -> Constraints:
        """Constraints of a mask."""
        return Constraints(self.dofs[mask], self.lower[mask], self.upper[mask], self.weight[mask])


def check_shapes(
    name: str, found: object, shapes: Mapping[str, tuple[int, ...]], *, infinite: bool = False
) -> None:
    """Raise a ValueError for wrong ``shapes``, by field names, or NaN."""
    for part, shape in shapes.items():
        values = np.asarray(getattr(found, part))
        if values.shape != shape:
            raise ValueError(f"{name} {part} of shape {values.shape}: it must be {shape}")
        if not np.isfinite(values).all() and (not infinite or np.isnan(values).any()):
            raise ValueError(f"{name} {part} with NaN{'' if infinite else ' or infinity'}")


def check_constraints(name: str, found: Constraints, nodes: Ints, directions: Bools) -> None:
    """Raise a ValueError for invalid bounds at nodes in directions (n, d)."""
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


def equalities(dofs: Ints, values: Floats) -> Constraints:
    """Constraints y = values.

    >>> equalities(np.array([4], dtype=np.int32), np.array([0.5])).equal.tolist()
    [True]
    """
    return Constraints(dofs.astype(np.int32), values, values, np.ones(len(dofs)))


T = TypeVar("T", Constraints, "SlipLimits")


def join(parts: Sequence[T]) -> T:
    """Concatenate the arrays of records, at least one."""
    columns = ([getattr(part, column.name) for part in parts] for column in fields(parts[0]))
    return type(parts[0])(*map(np.concatenate, columns))


# Elastic slip at prescribed slips, in facets: for convergence mu p / ROOM must be below E.
ROOM = 0.05


@dataclass(frozen=True)
class SlipLimits:
    """Limits of tangential reactions, in this rank's numbering.

    |z_t| <= coefficient z_n + cohesion where closed. In prescribed directions the slip s_e is
    known, not z_t; with the elastic slip a and the other slip s_t its share of the limit is

        q / max(|q + s_t / a|, 1),     q = (share at the last commit) + s_e / a.
    """

    nodes: Ints  # (m,) owned
    normal: Ints  # (m,) bounded unknown w_n of y
    tangential: Ints  # (m, d - 1) unknowns of y, -1 where prescribed
    axes: Floats  # (m, d - 1, d) directions of these
    slip: Floats  # (m, d - 1) since the last commit
    coefficient: Floats  # (m,) mu
    cohesion: Floats  # (m,) force, D_jj times traction
    weight: Floats  # (m,) D_jj
    beside: Floats  # (m, d) slip vector in prescribed directions
    before: Floats  # (m, d) share at the last commit
    room: Floats  # (m,) a
    opening: Floats  # (m, d) motion of the node by unit w_n

    @property
    def shares(self) -> Floats:
        """Vectors (m, d) of the share of the limit in prescribed directions."""
        q, size = self._asked()
        return q / np.maximum(size, 1.0)[:, None]

    @property
    def slides(self) -> Bools:
        """Nodes (m,) whose prescribed slip takes the whole limit."""
        q, size = self._asked()
        return q.any(axis=1) & (size >= 1.0)

    def _asked(self) -> tuple[Floats, Floats]:
        """Vectors q (m, d), and sizes (m,) of q + s_t / a."""
        a = self.room[:, None]
        q = self.before + self.beside / a
        return q, np.hypot(np.linalg.norm(q, axis=1), np.linalg.norm(self.slip / a, axis=1))

    @property
    def left(self) -> tuple[Floats, Floats]:
        """Coefficient and cohesion (m,) for the tangential unknowns."""
        part = np.sqrt(np.maximum(1.0 - (self.shares**2).sum(axis=1), 0.0))
        return self.coefficient * part, self.cohesion * part

    @property
    def wedging(self) -> Floats:
        """Factor (m,) of lambda_j by which prescribed slip opens the contact."""
        return self.coefficient * np.asarray((self.opening * self.shares).sum(axis=1))

    def known(self, multipliers: Floats) -> Floats:
        """Reactions (m, d) in prescribed directions, given lambda_j (owned nodes,)."""
        limit = self.coefficient * self.weight * multipliers[self.nodes] + self.cohesion
        return limit[:, None] * self.shares

    @property
    def some(self) -> Bools:
        """Tangential unknowns (m, d - 1)."""
        return np.asarray(self.tangential >= 0)

    def along(self, vectors: Floats) -> Floats:
        """Tangential components (m, d - 1) of vectors (m, d)."""
        return np.where(self.some, np.einsum("mti,mi->mt", self.axes, vectors), 0.0)

    def vectors(self, parts: Floats) -> Floats:
        """Vectors (m, d) of tangential components (m, d - 1)."""
        return np.einsum("mti,mt->mi", self.axes, parts)


Force: TypeAlias = float | fem.Constant
"""A number, or a scalar Constant."""


def _read_force(value: Any) -> Force | None:
    if isinstance(value, fem.Constant):
        real = value.value.shape == () and value.value.dtype == np.float64
        return value if real else None
    return value if is_number(value) else None


FORCE: Rule[Any] = Rule("give a finite number or a scalar Constant", _read_force)


def present_force(name: str, given: Any) -> float:
    """Present value; raise a ValueError for NaN or infinity."""
    force = float(getattr(given, "value", given))
    if not np.isfinite(force):
        raise ValueError(f"{name} is {force}: set the Constant to a finite number")
    return force


@dataclass(frozen=True)
class Coefficient:
    """Coefficient of friction as a function of the state at each node.

        mu, *state = function(p, s, *state, *reads)

    with the pressure p and the slip s of the step, and the states at its start. Step and
    coefficient are solved in turn until they agree to rtol, relative to the largest mu. With the
    step its states are committed; `Contact.gather` has them and the "coefficient".

    Args:
        function: of arrays (n,) at all nodes of the rank, also those without contact; returns the
            coefficient alone, or a tuple of it and the states at the end of the step. It is called
            several times in a step and must change nothing. A rate is s over the Constant that
            `load_steps` sets by ``dt=``.
        state: initial values by name.
        reads: scalar Lagrange Functions, such as temperatures, for their values at the nodes.
        frozen: whether the coefficient is that of the end of the last step, and in the first one
            that of p = s = 0.

    Raises:
        ValueError: naming an argument of another kind.
    """

    function: Callable[..., Any]
    state: Mapping[str, float] = field(default_factory=dict)
    reads: Sequence[fem.Function] = ()
    frozen: bool = False

    def __post_init__(self) -> None:
        check("function", self.function, instance(Callable, "give a function of p and s"))
        for name, value in self.state.items():
            check(f"state[{name!r}]", value, NUMBER)
        for k, one in enumerate(self.reads):
            remedy = "give a scalar Lagrange Function"
            check(f"reads[{k}]", one, instance(fem.Function, remedy))
            check_nodal(f"reads[{k}]", one, (), remedy)


Limit: TypeAlias = float | fem.Constant | fem.Function | Callable[..., Any] | Coefficient
"""A number, Constant, Function, `Coefficient`, or the function of a frozen one."""

REMEDY = "give a number, a scalar Constant, a scalar Lagrange Function, or a function of p and s"


@dataclass(frozen=True)
class FrictionLaw:
    """Limit of the tangential traction tau at the pressure p.

    "friction": abs(tau) <= mu p (Coulomb); "tresca": abs(tau) <= s.
    """

    name: str
    value: Any  # a `Limit`, functions as `Coefficient`

    @property
    def by_pressure(self) -> bool:
        """Whether the limit is proportional to the pressure, zero at open nodes."""
        return self.name == "friction"

    @property
    def own(self) -> Sequence[str]:
        """Names of results of a `Coefficient`, which steps begin with."""
        return ("coefficient", *self.value.state) if isinstance(self.value, Coefficient) else ()

    def values(self, of: Any) -> Floats:
        """Values at the owned nodes, given the results of the interface; collective.

        Raises:
            ValueError: on all ranks, for negative or non-finite values.
        """
        scalar = of.pressure.function_space
        n = scalar.dofmap.index_map.size_local
        if isinstance(self.value, Coefficient):
            values = of.nodal["coefficient"].x.array[:n]
            if of.resultants is None:  # before the first step
                for name, start in self.value.state.items():
                    of.nodal[name].x.array[:] = start
                values[:] = self._evaluate(of)[0]
            return values.copy() if of.turns.now is None else of.turns.now
        return values_at_nodes(self.name, self.value, scalar, signed=False)[:n]

    def turn(self, of: Any) -> float:
        """Evaluate a `Coefficient` at the end of a step; return its change; collective."""
        used, found, comm = self.values(of), self._evaluate(of), of.turns.comm
        of.ended = dict(zip(self.own, found, strict=True))
        way = np.where(self.value.frozen, 0.0, found[0] - used)
        of.turns.now = used + of.turns(way)
        return ratio(largest(comm, way), largest(comm, used))

    def _evaluate(self, of: Any) -> Floats:
        """Values of `own` (k, n) at the end of the step; collective."""
        scalar, slip = of.pressure.function_space, of.step_slip.x.array
        s = np.linalg.norm(slip.reshape(-1, scalar.mesh.geometry.dim), axis=1)
        state = [of.nodal[name].x.array for name in self.own[1:]]
        n, k = scalar.dofmap.index_map.size_local, len(self.own)
        reads = [values_at_nodes(f"{self.name}: reads", f, scalar) for f in self.value.reads]
        at_nodes = [values[:n].copy() for values in (of.pressure.x.array, s, *state, *reads)]
        some = [(), (n,)] if k == 1 else []
        remedy = f"return (n,) of each of {', '.join(self.own)}"
        rule = array(*some, (k, n), finite=False, remedy=remedy)
        with raised_together(scalar.mesh.comm):
            found = check(f"{self.name}(p, s, ..)", self.value.function(*at_nodes), rule)
        rows = np.broadcast_to(found, (k, n)).copy()
        for i, name in enumerate((self.name, *self.own[1:])):
            check_at_nodes(name, rows[i], scalar, signed=i > 0)
        return rows


def values_at_nodes(
    name: str, value: Any, scalar: fem.FunctionSpace, *, signed: bool = True
) -> Floats:
    """Values at the local nodes; a ValueError for non-finite or negative ones; collective."""
    at = fem.Function(scalar)
    if isinstance(value, fem.Function):
        value.x.scatter_forward()  # ghosts may be set
        at.interpolate(value)
    else:
        at.x.array[:] = getattr(value, "value", value)
    values = np.array(at.x.array, dtype=np.float64)
    # round-off of zeros
    none = np.isfinite(values) & (values < 0.0) & (not signed)
    values[none & (values >= -ROUND_OFF * largest(scalar.mesh.comm, values))] = 0.0
    check_at_nodes(name, values, scalar, signed=signed)
    return values


def check_at_nodes(name: str, values: Floats, scalar: fem.FunctionSpace, *, signed: bool) -> None:
    """Raise a ValueError on all ranks with the place of a wrong value; collective."""
    wrong = ~(np.isfinite(values) & ((values >= 0.0) | signed))
    with raised_together(scalar.mesh.comm):
        for j in np.flatnonzero(wrong)[:1]:
            at = place(scalar.tabulate_dof_coordinates()[j])
            raise ValueError(
                f"{name} is {values[j]:g} at {at}: every value has to be finite"
                + ("" if signed else " and >= 0")
            )


def create_law(friction: Limit | None, tresca: Limit | None) -> FrictionLaw | None:
    """The law, or None; a ValueError for both or invalid ones."""
    if friction is not None and tresca is not None:
        raise ValueError(
            f"friction is {friction!r} and tresca is {tresca!r}: give one of the two, a "
            "coefficient of the pressure or a traction"
        )
    name, value = ("friction", friction) if tresca is None else ("tresca", tresca)
    if value is None:
        return None
    if isinstance(value, Real) and not isinstance(value, bool):
        limit = check(name, value, NOT_NEGATIVE)
        return FrictionLaw(name, limit) if limit > 0.0 else None
    if callable(value) and not isinstance(value, Expr):
        value = Coefficient(value, frozen=True)
    found = value if isinstance(value, Coefficient) else check_field(name, value)
    return FrictionLaw(name, found)


def check_field(name: str, value: Any) -> Limit:
    """Checked number, scalar Constant or nodal scalar Function; else a ValueError."""
    if is_number(value):
        return float(value)
    if isinstance(value, fem.Function):
        check_nodal(name, value, (), REMEDY)
    elif not isinstance(value, fem.Constant):
        raise ValueError(f"{name} is {value!r}: {REMEDY}")
    check_real(name, value)
    if value.ufl_shape != ():
        raise ValueError(f"{name} has shape {value.ufl_shape}: {REMEDY}")
    return value
