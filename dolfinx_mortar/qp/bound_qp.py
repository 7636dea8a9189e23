# SPDX-License-Identifier: MIT
"""Quadratic program with bounds and Coulomb friction.

At node j the reaction z = b - A x has a normal component z_n >= 0, the multiplier of the bound on
x_n, and tangential components z_t against the slip x_t - rest (theory.md, Friction):

    |z_t| <= s,    z_t = s (x_t - rest) / |x_t - rest| in slip,    s = mu z_n + cohesion,

or z_t = q min(1, s / |q|) with q = z_t + c (x_t - rest), c > 0. Linearised with d = q / |q|,

    z_t = s d + kappa (I - d d^T) (x_t - rest),    kappa = c s / (|q| - s).

An upper bound may yield, by a compliance a >= 0: its slack is upper - x + a z, as by wear in a step
(`interfaces.wear`). An active one is a free unknown with z = (x - upper) / a.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.algebra.parallel import any_rank, largest, maximum, norm, ratio
from dolfinx_mortar.common.arrays import EPS, ROUND_OFF, TINY, Actives, Bools, Floats, Ints


@dataclass(frozen=True)
class Friction:
    """Friction at this rank's m nodes, with at most t tangential unknowns."""

    normal: Ints  # (m,) position of x_n in `BoundQP.bounded`
    tangential: Ints  # (m, t) unknowns, -1 for none
    rest: Floats  # (m, t) x_t without slip, 0 for none
    coefficient: Floats  # (m,) mu >= 0
    cohesion: Floats  # (m,) force >= 0, the limit without pressure

    @property
    def some(self) -> Bools:
        """Entries (m, t) of unknowns."""
        return self.tangential >= 0

    def pick(self, values: Floats) -> Floats:
        """Tangential components (.., m, t) of vectors (.., n)."""
        if values.size == 0:  # a rank without unknowns
            return np.zeros(self.tangential.shape)
        return np.where(self.some, values[..., self.tangential], 0.0)

    def means(self, diagonal: Floats) -> Floats:
        """Mean (m,) of a diagonal over each node's tangential unknowns."""
        return self.pick(diagonal).sum(axis=1) / np.maximum(self.some.sum(axis=1), 1)

    def acts(self, closed: Bools) -> Bools:
        """Nodes (m,) that may have tangential reactions."""
        return closed | (self.cohesion > 0.0)

    def limit(self, pressing: Floats) -> Floats:
        """Limit s (m,) for normal reactions (m,); negative ones count as 0."""
        return self.coefficient * np.maximum(pressing, 0.0) + self.cohesion

    @property
    def across(self) -> Bools:
        """Nodes (m,) with two tangential unknowns."""
        return self.some.sum(axis=1) > 1

    def select(self, mask: Bools) -> Friction:
        """Some of the nodes."""
        return Friction(*(part[mask] for part in vars(self).values()))

    def put(self, values: Floats, parts: Floats) -> None:
        """Set the tangential components of vectors."""
        values[..., self.tangential[self.some]] = parts[..., self.some]


@dataclass(frozen=True)
class Sliding:
    """Linearised law of slipping nodes."""

    normal: Ints  # (m,) unknowns
    law: Friction  # of the slipping nodes
    direction: Floats  # (m, t) d
    stiffness: Floats  # (m,) kappa

    @staticmethod
    def yielding(unknowns: Ints, bounds: Floats, give: Floats, size: int) -> Sliding:
        """Law z = (x - bound) / give of yielding bounds, in the form of `size` components.

        A slip across d has the force kappa (x_t - rest) alone.
        """
        both = np.zeros((2, len(unknowns), size))
        both[0, :, 0], both[1, :, -1] = bounds, 1.0
        tangential = np.full((len(unknowns), size), -1, dtype=np.int32)
        tangential[:, 0] = unknowns
        law = Friction(unknowns, tangential, both[0], *np.zeros((2, len(unknowns))))
        return Sliding(unknowns, law, both[1], np.asarray(1.0 / give))

    @property
    def added(self) -> tuple[Ints, Floats]:
        """Unknowns of yielding bounds, and what they add to the diagonal."""
        own = self.law.tangential[:, 0] == self.normal
        return self.normal[own], self.stiffness[own]

    def joined(self, other: Sliding) -> Sliding:
        """Both laws; those with fewer components are padded."""
        t = other.direction.shape[1]
        more = [(0, 0), (0, t - self.direction.shape[1])]
        law = replace(
            self.law,
            tangential=np.pad(self.law.tangential, more, constant_values=-1),
            rest=np.pad(self.law.rest, more),
        )
        parts = zip(vars(law).values(), vars(other.law).values(), strict=True)
        return Sliding(
            np.concatenate([self.normal, other.normal]),
            Friction(*map(np.concatenate, parts)),
            np.concatenate([np.pad(self.direction, more), other.direction]),
            np.concatenate([self.stiffness, other.stiffness]),
        )

    def reaction(self, x: Floats, z: Floats) -> Floats:
        """z_t (m, t) of the law."""
        limit = self.law.coefficient * z[self.normal] + self.law.cohesion
        return self._resist(limit, self.law.pick(x) - self.law.rest)

    def add(self, x: Floats, y: Floats) -> None:
        """Add to y = A x (.., n) the derivative of the law's residual in the directions x."""
        limit = -self.law.coefficient * y[..., self.normal]
        self.law.put(y, self.law.pick(y) + self._resist(limit, self.law.pick(x)))

    def _resist(self, limit: Floats, slip: Floats) -> Floats:
        d = self.direction
        across = slip - d * (d * slip).sum(axis=-1, keepdims=True)
        return limit[..., None] * d + self.stiffness[:, None] * across


@dataclass(frozen=True)
class Sliders:
    """Primal-dual iterate at the nodes with friction."""

    law: Friction
    slip: Floats  # (m, t) x_t - rest
    reaction: Floats  # (m, t) z_t
    limit: Floats  # (m,) s
    stiffness: Floats  # (m,) c, which scales slips to forces

    @property
    def trial(self) -> Floats:
        """Trial force q (m, t)."""
        return self.reaction + self.stiffness[:, None] * self.slip

    def directions(self, before: Floats | None = None) -> tuple[Floats, Floats]:
        """Directions d (m, t), zero at sticking nodes, and kappa (m,) of the next state.

        A node whose slip ``before`` (m, t) would reverse sticks first, or neighbours could
        alternate.

        >>> nodes, rest = np.array([[0], [1]]), np.zeros((2, 1))
        >>> law = Friction(np.arange(2), nodes, rest, *np.ones((2, 2)))
        >>> stuck, slipping = np.array([0.5]), np.array([3.0])
        >>> z, one = np.array([stuck, slipping]), np.ones(2)
        >>> Sliders(law, np.zeros((2, 1)), z, one, one).directions()[0].tolist()
        [[0.0], [1.0]]
        """
        q = self.trial
        size = np.linalg.norm(q, axis=1)
        slips = size > self.limit
        if before is not None:
            slips &= (before * q).sum(axis=1) >= 0.0
        d = np.divide(q, size[:, None], out=np.zeros_like(q), where=slips[:, None])
        beyond = np.where(slips, size - self.limit, 1.0)
        kappa = np.where(slips, self.stiffness * self.limit / beyond, 0.0)
        return d, np.where(self.law.across, kappa, 0.0)

    def error(self) -> Floats:
        """Error z_t - q min(1, s / |q|) (m, t) in the law."""
        q = self.trial
        size = np.linalg.norm(q, axis=1)
        share = np.divide(self.limit, size, out=np.ones_like(size), where=size > self.limit)
        return self.reaction - q * share[:, None]


@dataclass(frozen=True)
class Scalars:
    """Scalar unknowns q (m,), lengths, see `qp.scalars`."""

    motions: Floats  # (m, n) e: bounds and rests hold for x - e.q
    loads: Floats  # (m,) F
    columns: Floats  # (m, n) C = -d(b - A x)/dq
    rows: Floats  # (m, n) R
    block: Floats  # (m, m) Q
    noise: Floats  # (m,) forces that count as zero

    def sizes(self, qp: BoundQP) -> Floats:
        """Largest stiffness of a node against each (m,), 0 for round-off; collective."""
        parts = np.vstack([self.motions**2 * qp.stiffness, EPS * qp.stiffness])
        tops = np.array(maximum(qp.comm, *parts.max(axis=1, initial=0.0)))
        found = np.where(tops[:-1] > tops[-1], tops[:-1], 0.0)
        return np.where(found > 0.0, found, np.abs(np.diag(self.block)))


@dataclass(frozen=True)
class BoundQP:
    """Minimise 1/2 x'Ax - b'x over lower <= x <= upper, with friction.

    The reaction z = b - A x is >= 0 at an active upper bound, <= 0 at an active lower bound, else
    0. With friction or an indefinite A there is no minimum, but several or no solutions of these
    conditions.
    """

    A: PETSc.Mat  # (n, n)
    b: PETSc.Vec  # (n,) force
    lower: PETSc.Vec  # (n,) PETSC_NINFINITY for none
    upper: PETSc.Vec  # (n,) PETSC_INFINITY for none
    bounded: Ints  # (k,) owned local unknowns with a finite bound
    friction: Friction | None = None  # on all ranks or on none
    # Whether A is symmetric, and positive definite on unknowns without bounds.
    definite: bool = True
    product: CongruentOperator | None = None  # A as an operator, not formed
    near: PETSc.Mat | None = None  # definite, for the multigrid of A
    extent: float = 0.0  # size of coordinates, whose differences are the bounds
    scalars: Scalars | None = None  # on all ranks or on none
    taken: float = 0.0  # norm of the part of b due to scalars
    give: Floats | None = None  # (k,) compliance of upper bounds; on all ranks or on none

    @cached_property
    def comm(self) -> MPI.Comm:
        """Communicator of A."""
        return self.A.comm.tompi4py()

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """(lower, upper) on `bounded`, with infinities."""
        lower = self.lower.array_r[self.bounded].copy()
        upper = self.upper.array_r[self.bounded].copy()
        lower[lower <= PETSc.NINFINITY] = -np.inf
        upper[upper >= PETSc.INFINITY] = np.inf
        return lower, upper

    @cached_property
    def held(self) -> Ints:
        """Owned unknowns with bounds or friction, ascending."""
        law = self.friction
        found = [] if law is None else [law.tangential[law.some]]
        return np.unique(np.concatenate([self.bounded, *found])).astype(np.int32)

    @cached_property
    def diagonal(self) -> PETSc.Vec:
        """Diagonal (n,) of A, read once (collective)."""
        return self.A.getDiagonal()

    @cached_property
    def stiffness(self) -> Floats:
        """|diag(A)| (n,), nonzero (collective)."""
        diagonal = self.diagonal
        if not self.definite:
            diagonal = diagonal.copy()
            diagonal.abs()
            mean = diagonal.sum() / diagonal.getSize()
            diagonal.array[diagonal.array_r == 0.0] = mean
        return diagonal.array_r

    @cached_property
    def noise(self) -> float:
        """Norm of the forces due to round-off of bounds; collective at first."""
        return ROUND_OFF * norm(self.comm, self.extent * self.stiffness[self.bounded])


@dataclass(frozen=True)
class Bounded:
    """Primal-dual iterate at the bounded unknowns."""

    x: Floats  # (k,) of yielding bounds upper - slack / (1 + a c)
    z: Floats  # (k,) reaction b - A x
    lower: Floats  # (k,) -inf for none
    upper: Floats  # (k,) inf for none
    stiffness: Floats  # (k,) c = |diag(A)|

    def predicted(self) -> Actives:
        """Next active set of the primal-dual active-set method.

        Upper bounds are active where z + c (x - upper) > 0, lower ones where z + c (x - lower) < 0.

        >>> one = np.ones(3)
        >>> Bounded(np.array([0.5, 1.0, 2.0]), 0 * one, -one, one, one).predicted().tolist()
        [0, 0, 1]
        """
        active = np.zeros(self.x.size, dtype=np.int8)
        active[self.z + self.stiffness * (self.x - self.upper) > 0.0] = 1
        active[self.z + self.stiffness * (self.x - self.lower) < 0.0] = -1
        return active

    def strength(self, active: Actives, new: Actives) -> Floats:
        """Sizes |z| + c |x - bound| of unknowns that differ between two sets, 0 at others."""
        side = np.where((active > 0) | (new > 0), self.upper, self.lower)
        side = np.where(np.isfinite(side), side, self.x)
        strength = np.abs(self.z) + self.stiffness * np.abs(self.x - side)
        return np.where(active != new, strength, 0.0)


@dataclass(frozen=True)
class KKT:
    """Residuals of the optimality conditions, relative to |b| + |bounded z| or max |x|."""

    stationarity: float  # |z| over free unknowns
    feasibility: float  # largest violation of a bound
    sign: float  # largest reaction of the wrong sign
    complementarity: float  # largest min(|reaction|, distance to its bound)
    force_floor: float  # round-off
    unsolved: float = 0.0  # |z| over free unknowns, a force
    friction: float = 0.0  # error in the law of friction

    def satisfied(self, rtol: float) -> bool:
        """Whether every residual is below rtol or its round-off."""
        force, length = max(rtol, self.force_floor), max(rtol, ROUND_OFF)
        return bool(
            max(self.stationarity, self.sign) <= force
            and self.friction <= max(rtol, 2.0 * self.force_floor)
            and self.feasibility <= length
            and self.complementarity <= max(force, length)
        )

    @property
    def worst(self) -> float:
        """Largest of the residuals (inf if one is NaN)."""
        residuals = self.stationarity, self.feasibility, self.sign, self.complementarity
        worst = float(np.max([*residuals, self.friction]))
        return float("inf") if np.isnan(worst) else worst


@dataclass(frozen=True)
class QPSolution:
    """Solution of a BoundQP and its cost."""

    x: PETSc.Vec  # (n,)
    z: PETSc.Vec  # (n,) reaction b - A x
    active: Actives  # (k,) on `bounded`: +1 at upper, -1 at lower, 0 free
    kkt: KKT
    updates: int  # changes of the active set, or iterations of the backend
    linear_iterations: int
    factorisations: int
    backend: str
    note: str = ""
    sliding: Floats | None = None  # (m, t) directions of slipping nodes, zero at others
    linearisation: str = ""  # of friction
    travel: Floats | None = None  # (m,) q of `moved`
    resistance: Floats | None = None  # (m, m) resistance of the forces to q


class QPNotSolved(RuntimeError):
    """A backend ended without a solution that passes the KKT check.

    Attributes:
        solution: the last iterate with its KKT residuals, or None.
    """

    def __init__(self, message: str, solution: QPSolution | None = None) -> None:
        super().__init__(message)
        self.solution = solution


class UnusableQP(ValueError):
    """The data have no solution."""


def validate(qp: BoundQP) -> None:
    """Raise `UnusableQP` on all ranks for crossing or wrong bounds, NaN, or wrong indices."""
    lower, upper = qp.lower.array_r, qp.upper.array_r
    diagonal = qp.diagonal.array_r
    outside = (qp.bounded < 0) | (qp.bounded >= lower.size)
    unlisted = (lower > PETSc.NINFINITY) | (upper < PETSc.INFINITY)
    unlisted[qp.bounded[~outside]] = False
    wrong = (lower >= PETSc.INFINITY) | (upper <= PETSc.NINFINITY)
    problems = {
        "bounded: indices that this rank does not own": outside,
        "bounded: unknowns with a finite bound are missing": unlisted,
        "b: NaN or infinity; check loads and state": ~np.isfinite(qp.b.array_r),
        "A: NaN or infinity on its diagonal; check the tangent": ~np.isfinite(diagonal),
        "A: entries <= 0 on its diagonal, so it is not positive definite": (
            qp.definite & (diagonal <= 0.0)
        ),
        "lower, upper: NaN": np.isnan(lower) | np.isnan(upper),
        "lower, upper: infinite bounds of the wrong sign": wrong,
        "lower, upper: lower > upper, which no x can satisfy": lower > upper,
    }
    found = any_rank(qp.comm, *map(np.any, problems.values()))
    for text, bad in zip(problems, found, strict=True):
        if bad:
            raise UnusableQP(f"The quadratic program cannot be used: {text}.")


def reaction(qp: BoundQP, x: PETSc.Vec) -> PETSc.Vec:
    """Return z = b - A x, without a product for x = 0."""
    if x.norm(PETSc.NormType.INFINITY) == 0.0:
        return qp.b.copy()
    z = qp.b.duplicate()
    qp.A.mult(x, z)
    z.aypx(-1.0, qp.b)
    return z


def on_bounded(qp: BoundQP, x: PETSc.Vec, z: PETSc.Vec) -> Bounded:
    """An iterate at this rank's bounded unknowns."""
    own, (lower, upper) = qp.bounded, qp.bounds
    c, values, reaction = qp.stiffness[own], x.array_r[own], z.array_r[own]
    if (a := qp.give) is not None:  # as accurate as its force
        slack = (upper - values + a * reaction) / (1.0 + a * c)
        slack[np.abs(slack) <= ROUND_OFF * qp.extent] = 0.0  # of coordinates
        values = np.where(a > 0.0, upper - slack, values)
    return Bounded(values, reaction, lower, upper, c)


def on_friction(qp: BoundQP, x: PETSc.Vec, z: PETSc.Vec, found: Bounded) -> Sliders:
    """Iterate at this rank's nodes with friction; limits include forces that close penetrations."""
    law = qp.friction
    assert law is not None
    n = law.normal
    pressing = found.z[n] + found.stiffness[n] * (found.x[n] - found.upper[n])
    limit = law.limit(pressing)
    slip, stiffness = law.pick(x.array_r) - law.rest, law.means(qp.stiffness)
    return Sliders(law, slip, law.pick(z.array_r), limit, stiffness)


def is_noise(qp: BoundQP, x: PETSc.Vec, z: PETSc.Vec) -> bool:
    """Whether all forces z = b - A x may be round-off of bounds; collective."""
    if max(qp.b.norm(), z.norm()) > qp.noise:
        return False
    bounded, errors = on_bounded(qp, x, z), np.zeros(0)
    if qp.friction is not None:
        errors = on_friction(qp, x, z, bounded).error().ravel()
    outside = np.maximum(bounded.x - bounded.upper, bounded.lower - bounded.x)
    violated = bounded.stiffness * np.maximum(outside, 0.0)
    return norm(qp.comm, violated, errors) <= qp.noise


def check(qp: BoundQP, x: PETSc.Vec, z: PETSc.Vec | None = None) -> KKT:
    """Residuals of the optimality conditions at x (n,), from the data alone (collective).

    z = b - A x is computed if None.
    """
    z = reaction(qp, x) if z is None else z
    if is_noise(qp, x, z):
        return KKT(*np.zeros(5))
    bounded = on_bounded(qp, x, z)
    xb, zb, lower, upper = bounded.x, bounded.z, bounded.lower, bounded.upper
    active = bounded.predicted()
    free = np.ones(x.local_size, dtype=bool)
    free[qp.bounded[active != 0]] = False
    wrong: Floats = np.zeros(0)
    zt: Floats = np.zeros(0)
    if qp.friction is not None:
        sliders = on_friction(qp, x, z, bounded)
        wrong, zt = sliders.error().ravel(), sliders.reaction.ravel()
        free[qp.friction.tangential[qp.friction.some]] = False
    over, under = np.maximum(xb - upper, 0.0), np.maximum(lower - xb, 0.0)
    pull = np.where(active == 0, 0.0, np.maximum(-active * zb, 0.0))
    # the sign of a reaction tells its bound; infinite ones are in stationarity
    side = np.where(zb > 0.0, upper, lower)
    distance = np.abs(np.where(np.isfinite(side), side, xb) - xb)
    sizes = np.abs(x.array_r), np.maximum(over, under), pull
    nearest = np.minimum(np.abs(lower), np.abs(upper)).min(initial=np.inf)
    tops = [a.max(initial=0.0) for a in sizes] + [-nearest]
    x_top, gap_top, pull_top, nearest = maximum(qp.comm, *tops)
    # without forces, x is round-off of the nearest bounds
    moved = np.abs(x.array_r)
    if np.isfinite(nearest):
        moved[qp.bounded] = np.maximum(moved[qp.bounded], -nearest)
    round_off = qp.stiffness * moved
    parts = (qp.b.array_r, zb, z.array_r[free], round_off, wrong, zt)
    squares = qp.comm.allreduce(np.array([v @ v for v in parts]))
    b2, zb2, free2, off2, wrong2, zt2 = np.sqrt(squares)
    force, length = b2 + np.hypot(zb2, zt2), max(x_top, gap_top)
    off2 = off2 + qp.taken
    # a product would mix distant bounds with round-off in z
    forces = np.abs(zb) / force if force > 0.0 else np.zeros_like(zb)
    both = np.minimum(forces, distance / max(length, TINY))
    return KKT(
        stationarity=ratio(free2, force),
        feasibility=ratio(gap_top, length),
        sign=ratio(pull_top, force),
        complementarity=largest(qp.comm, both),
        force_floor=ROUND_OFF * ratio(off2, force) if force > 0.0 else 0.0,
        unsolved=float(free2),
        friction=ratio(wrong2, force),
    )
