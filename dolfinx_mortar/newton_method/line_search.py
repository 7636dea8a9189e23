# SPDX-License-Identifier: MIT
"""Backtracking line search: t = 1, 1/2, 1/4 .. until the merit function decreases.

    phi(t) = J(u + t du) + s sum_j D_jj (t w_j - gap_j)_+ + sum_j s_j |slip_j + t dw_j|,

with friction limits s_j of the QP's solution. With tools driven by forces F, w is relative to their
motion t q, and -t F.q is added. Armijo's condition holds up to round-off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import EPS, QUARTER_OF_DIGITS, Floats
from dolfinx_mortar.newton_method.contacts import gap_round_off, round_off
from dolfinx_mortar.newton_method.driven_tools import Settled
from dolfinx_mortar.newton_method.failures import StepFailed
from dolfinx_mortar.newton_method.linearisation import Linearisation, to_displacement
from dolfinx_mortar.newton_method.subproblem import Iterate, Solution
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import QPSolution
from dolfinx_mortar.solid.solid import volume_step
from dolfinx_mortar.spaces import with_values
from dolfinx_mortar.terms.sum import Energy, VolumeStep

# Sufficient decrease relative to the slope (Armijo; Nocedal and Wright 2006), and least length.
ARMIJO = 1e-4

Curve = Callable[[float], Floats]
"""By how much a path is beside u + t du at t (n,): that of sides that turn as rigid bodies."""


class NoDescent(RuntimeError):
    """No step along the direction decreases the merit function."""


@dataclass(frozen=True)
class Direction:
    """Path u + t du, y + t dy, and the terms of phi except J."""

    start: Floats
    du: Floats  # (n,)
    motion: Floats  # (k,) of bounded unknowns
    gap: Floats  # (k,) bounds including round-off
    penalty: Floats  # (k,) s D_jj
    noise: float  # error of r.du by round-off and the QP's residual
    slip: Floats  # (m, d - 1) at the start
    slide: Floats  # (m, d - 1) in the step
    limits: Floats  # (m,) of friction
    pull: float = 0.0  # -F.q of driven tools (one rank), and known friction
    curve: Curve | None = None

    def at(self, t: float) -> Floats:
        """Displacement (n,) at t."""
        return on_path(self.start, self.du, t, self.curve)

    def excess(self, t: float) -> float:
        """Terms of penalty and friction at t, of this rank."""
        slips = np.linalg.norm(self.slip + t * self.slide, axis=1)
        over = np.maximum(t * self.motion - self.gap, 0.0)
        return float(self.penalty @ over + self.limits @ slips) + t * self.pull

    def beside(self, lin: Linearisation, driven: Settled) -> Direction:
        """Path relative to moving tools."""
        way = driven.travel @ driven.drives.motions
        first = driven.drives.comm.rank == 0
        path = replace(
            self,
            motion=self.motion - way[lin.balance.bounds.dofs],
            pull=self.pull - (float(driven.drives.loads @ driven.travel) if first else 0.0),
            curve=driven.curve,
        )
        if (law := lin.qp.friction) is None or lin.balance.limits is None:
            return path
        return replace(path, slip=lin.balance.limits.slip, slide=self.slide - law.pick(way))


@dataclass(frozen=True)
class Moved:
    """Changes by a step along the solution of a QP."""

    increment: float
    length: float  # t
    halvings: int
    energy: Energy | None  # J at the end
    travel: Floats  # (m,) of driven tools since the step began
    pressure: Floats | None  # (owned cells,) linearised mean stresses


def take_step(problem: ContactProblem, found: Solution, largest: float, old: Iterate) -> Moved:
    """Move u and driven tools along the solution of the QP; collective.

    `largest` is the largest multiplier so far.
    """
    lin = found.lin
    T = problem.system.transformation if lin.geometry is None else lin.geometry.trial
    du = to_displacement(T, found.solved.x)
    _check_distance(du, old.scales.extent)
    direction = with_values(problem.V, du.array_r)
    volumes = volume_step(problem.solid, direction)
    length, halvings, energy = _move(problem, found, du, largest, old, volumes)
    travel = old.travel
    if found.driven is not None:
        moved = length * found.driven.travel
        travel = travel + moved if len(travel) else moved
        found.driven.drives.move(moved)
    pressure = None if volumes is None else volumes.pressure_at(length)
    increment = problem.solid.elastic_norm(direction)
    return Moved(increment, length, halvings, energy, travel, pressure)


def _check_distance(du: PETSc.Vec, extent: float) -> None:
    farthest = du.norm(PETSc.NormType.INFINITY)
    if not QUARTER_OF_DIGITS * farthest <= extent:
        raise StepFailed(
            f"a Newton step is {farthest:.1e} long in a model of size {extent:.1e}",
            "The tangent is singular, because nothing holds a body or nothing resists its "
            "plastic flow, or a load or pretension is too large for the stiffness (check units "
            "of both)",
        )


def _move(
    problem: ContactProblem,
    found: Solution,
    du: PETSc.Vec,
    largest: float,
    old: Iterate,
    volumes: VolumeStep | None,
) -> tuple[float, int, Energy | None]:
    """Move u along the step, whole if the energy may increase; return length, halvings, J."""
    energy = old.energy
    lin, solved, driven = found.lin, found.solved, found.driven
    lost = gap_round_off(problem.u)
    asked = float(maximum(problem.comm, old.balance.equal.scale)[0])
    with problem.timings("assembly"):
        try:
            saddle = found.negative and not found.shift
            if energy is None or asked > lost or found.exact or saddle:
                curve = None if driven is None else driven.curve
                return *shorten(problem, du.array_r, curve), problem.terms.energy()
            way = search(problem, lin, solved, du, largest, energy, volumes, driven)
            return way if volumes is None else (*way[:2], problem.terms.energy())
        except NoDescent as error:
            raise StepFailed(str(error)) from error


def search(
    problem: ContactProblem,
    lin: Linearisation,
    solved: QPSolution,
    du: PETSc.Vec,
    multiplier: float,
    before: Energy,
    volumes: VolumeStep | None = None,
    driven: Settled | None = None,
) -> tuple[float, int, Energy]:
    """Backtrack along a Newton direction until the merit decreases; u is moved; collective.

    Args:
        du: the step in u.
        multiplier: largest so far; s is twice as large.
        before: J at the start.
        volumes: with mean stresses as unknowns, see `mean_volume`.
        driven: motions of tools, which are not moved here.

    Returns:
        Length, number of halvings, and J at the end.

    Raises:
        NoDescent: if the length falls to ARMIJO.
    """
    path = create_path(problem, lin, solved, du, multiplier)
    if driven is not None:
        path = path.beside(lin, driven)
    cells = problem.V.mesh.topology.index_map(problem.V.mesh.topology.dim).size_global
    first = problem.comm.allreduce(path.excess(0.0))
    promise = find_slope(problem, lin, path)
    length, halvings, inverted = 1.0, 0, ""
    while length > ARMIJO:
        move(problem, path.at(length))
        along = None if volumes is None else (volumes, length)
        after, penalty = problem.terms.energy(along), problem.comm.allreduce(path.excess(length))
        assert after is not None
        if not np.isfinite(after.value):
            inverted = describe_inverted(problem)
            length, halvings = 0.5 * length, halvings + 1
            continue
        inverted = ""
        # a sum of n equal terms loses about sqrt(n) units of round-off
        noise = EPS * np.sqrt(cells) * (before.terms + after.terms + first + penalty) + path.noise
        target = before.value + first + ARMIJO * length * min(promise, 0.0)
        if after.value + penalty <= target + noise:
            return length, halvings, after
        length, halvings = 0.5 * length, halvings + 1
    move(problem, path.start)
    raise NoDescent(inverted or "the line search found no step that lowers the energy")


def on_path(start: Floats, du: Floats, t: float, curve: Curve | None) -> Floats:
    """Displacement (n,) at t of a path."""
    straight = start + t * du
    return straight if curve is None else straight + curve(t)


def shorten(problem: ContactProblem, du: Floats, curve: Curve | None = None) -> tuple[float, int]:
    """Move u along a step, halved while cells are inverted; return length and halvings; collective.

    Raises:
        NoDescent: at the length ARMIJO; u is unchanged.
    """
    start = problem.u.x.array[: du.size].copy()
    length, halvings, volumes = 1.0, 0, problem.solid.volumes
    move(problem, on_path(start, du, 1.0, curve))
    while volumes is not None and volumes.inverted():
        length, halvings = 0.5 * length, halvings + 1
        if length <= ARMIJO:
            inverted = describe_inverted(problem)
            move(problem, start)
            raise NoDescent(inverted)
        move(problem, on_path(start, du, length, curve))
    return length, halvings


def describe_inverted(problem: ContactProblem) -> str:
    """Message about inverted cells at u, "" for none; collective."""
    volumes = problem.solid.volumes
    where = "" if volumes is None else volumes.describe_inverted()
    return f"{where}, however short the step: take smaller load steps" if where else ""


def create_path(
    problem: ContactProblem,
    lin: Linearisation,
    solved: QPSolution,
    du: PETSc.Vec,
    multiplier: float,
) -> Direction:
    """Path from the present u along a Newton direction; collective."""
    bounds, own = lin.balance.bounds, du.local_size
    # reactions times round-off of gaps and supports; residual of the QP
    held = lin.balance.reduced.array_r[lin.balance.equal.dofs]
    slip, slide, limits = _friction(lin, solved)
    local = np.abs(solved.z.array_r[bounds.dofs]).sum() + np.abs(held).sum() + limits.sum()
    touching = problem.comm.allreduce(float(local))
    unbalanced = round_off(problem.u, lin.diagonal) + solved.kkt.unsolved
    lost = gap_round_off(problem.u)
    return Direction(
        start=problem.u.x.array[:own].copy(),
        du=du.array_r.copy(),
        motion=solved.x.array_r[bounds.dofs],
        gap=bounds.upper + lost,
        penalty=2.0 * multiplier * bounds.weight,
        noise=unbalanced * du.norm() + lost * touching,
        slip=slip,
        slide=slide,
        limits=limits,
        pull=0.0 if (given := lin.balance.friction) is None else -float(given @ du.array_r),
    )


def _friction(lin: Linearisation, solved: QPSolution) -> tuple[Floats, Floats, Floats]:
    law, bounds = lin.qp.friction, lin.balance.bounds
    if law is None:
        return np.zeros((0, 1)), np.zeros((0, 1)), np.zeros(0)
    closed = solved.active[law.normal] > 0
    pressing = np.where(closed, solved.z.array_r[bounds.dofs][law.normal], 0.0)
    return -law.rest, law.pick(solved.x.array_r), law.limit(pressing)


def find_slope(problem: ContactProblem, lin: Linearisation, path: Direction) -> float:
    """Slope phi'(0), with the whole decrease of the penalty; collective.

    A solution of the QP closes violated gaps in proportion to t.
    """
    forces = lin.balance.r.array_r
    if lin.balance.friction is not None:  # its work is in the excess
        forces = forces - lin.balance.friction
    local = -float(forces @ path.du) + path.excess(1.0) - path.excess(0.0)
    return float(problem.comm.allreduce(local))


def move(problem: ContactProblem, values: Floats) -> None:
    """Set the displacement to owned values; collective."""
    problem.u.x.array[: values.size] = values
    problem.u.x.scatter_forward()
