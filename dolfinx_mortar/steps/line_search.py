# SPDX-License-Identifier: MIT
"""Backtracking line search: t = 1, 1/2, 1/4 .. until the merit function decreases.

    phi(t) = J(u + t du) + s sum_j D_jj (t w_j - gap_j)_+ + sum_j s_j |slip_j + t dw_j|,

with friction limits s_j of the QP's solution. With tools driven by forces F, w is relative to their
motion t q, and -t F.q is added. Armijo's condition holds up to round-off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common.arrays import EPS, QUARTER_OF_DIGITS, Floats
from dolfinx_mortar.common.spaces import with_values
from dolfinx_mortar.problem.contacts import gap_round_off, round_off
from dolfinx_mortar.problem.linearisation import Linearisation, to_displacement
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.solid.solid import volume_step
from dolfinx_mortar.steps.failures import StepFailed
from dolfinx_mortar.steps.subproblem import Iterate, Solution
from dolfinx_mortar.terms.sum import Energy, VolumeStep

# Sufficient decrease relative to the slope (Armijo; Nocedal and Wright 2006), and least length.
ARMIJO = 1e-4


@dataclass(frozen=True)
class Path:
    """Path u + t du, y + t dy, relative to moving tools, and the terms of phi except J."""

    start: Floats
    du: Floats  # (n,)
    motion: Floats  # (k,) of bounded unknowns
    gap: Floats  # (k,) bounds including round-off
    penalty: Floats  # (k,) s D_jj
    noise: float  # error of r.du by round-off and the QP's residual
    slip: Floats  # (m, d - 1) at the start
    slide: Floats  # (m, d - 1) in the step
    limits: Floats  # (m,) of friction
    pull: float  # -F.q of driven tools (one rank), and known friction
    # (n,) of sides that turn as rigid bodies, beside the line
    curve: Callable[[float], Floats | float]

    def at(self, t: float) -> Floats:
        """Displacement (n,) at t."""
        return self.start + t * self.du + self.curve(t)

    def excess(self, t: float) -> float:
        """Terms of penalty and friction at t, of this rank."""
        slips = np.linalg.norm(self.slip + t * self.slide, axis=1)
        over = np.maximum(t * self.motion - self.gap, 0.0)
        return float(self.penalty @ over + self.limits @ slips) + t * self.pull


@dataclass(frozen=True)
class Moved:
    """Changes by a step along the solution of a QP."""

    increment: float
    length: float  # t
    halvings: int
    energy: Energy | None  # J at the end
    travel: Floats  # (m,) of driven tools since the step began
    pressure: Floats | None  # (owned cells,) linearised mean stresses


def take_step(problem: ContactProblem, found: Solution, penalty: float, old: Iterate) -> Moved:
    """Move u and driven tools along the solution of the QP; collective.

    `penalty` is the largest multiplier so far. The step is whole if the energy may increase.
    """
    lin, extent = found.lin, old.scales.extent
    T = problem.system.transformation if lin.geometry is None else lin.geometry.trial
    du = to_displacement(T, found.solved.x)
    farthest = du.norm(PETSc.NormType.INFINITY)
    if not QUARTER_OF_DIGITS * farthest <= extent:
        raise StepFailed(
            f"a Newton step is {farthest:.1e} long in a model of size {extent:.1e}",
            "The tangent is singular, because nothing holds a body or nothing resists its "
            "plastic flow, or a load or pretension is too large for the stiffness (check units "
            "of both)",
        )
    direction = with_values(problem.V, du.array_r)
    volumes = volume_step(problem.solid, direction)
    path = create_path(problem, found, du, penalty)
    asked = float(maximum(problem.comm, old.balance.equal.scale)[0])
    saddle = found.negative and not found.shift
    may_rise = asked > gap_round_off(problem.u) or found.exact or saddle
    with problem.timings("assembly"):
        before = None if may_rise else old.energy
        length, halvings, energy = search(problem, lin, path, before, volumes)
        if before is None or volumes is not None:
            energy = problem.terms.energy()
    travel = old.travel
    if found.travel is not None:
        moved = length * found.travel
        travel = travel + moved if len(travel) else moved
        lin.drives.move(moved)
    pressure = None if volumes is None else volumes.pressure_at(length)
    increment = problem.solid.elastic_norm(direction)
    return Moved(increment, length, halvings, energy, travel, pressure)


def search(
    problem: ContactProblem,
    lin: Linearisation,
    path: Path,
    before: Energy | None,
    volumes: VolumeStep | None = None,
) -> tuple[float, int, Energy | None]:
    """Backtrack along a path until the merit decreases; u is moved; collective.

    Args:
        before: J at the start, or None to halve the step only while cells are inverted.
        volumes: with mean stresses as unknowns, see `mean_volume`.

    Returns:
        Length, number of halvings, and J at the end.

    Raises:
        StepFailed: if the length falls to ARMIJO; u is unchanged.
    """
    cells = problem.V.mesh.topology.index_map(problem.V.mesh.topology.dim).size_global
    first, promise = problem.comm.allreduce(path.excess(0.0)), find_slope(problem, lin, path)
    length, halvings, solid, inverted = 1.0, 0, problem.solid.volumes, False
    why = "the line search found no step that lowers the energy"
    while length > ARMIJO:
        problem.move(path.at(length))
        inverted = solid is not None and solid.inverted()
        if not inverted:
            if before is None:
                return length, halvings, None
            along = None if volumes is None else (volumes, length)
            after = problem.terms.energy(along)
            assert after is not None
            penalty = problem.comm.allreduce(path.excess(length))
            # a sum of n equal terms loses about sqrt(n) units of round-off
            size = before.terms + after.terms + first + penalty
            noise = EPS * np.sqrt(cells) * size + path.noise
            target = before.value + first + ARMIJO * length * min(promise, 0.0)
            if after.value + penalty <= target + noise:
                return length, halvings, after
        length, halvings = 0.5 * length, halvings + 1
    if inverted and solid is not None:
        why = f"{solid.describe_inverted()}, however short the step: take smaller load steps"
    problem.move(path.start)
    raise StepFailed(why)


def create_path(problem: ContactProblem, found: Solution, du: PETSc.Vec, multiplier: float) -> Path:
    """Path from the present u along a Newton step, s twice the `multiplier`; collective."""
    lin, solved, balance = found.lin, found.solved, found.lin.balance
    bounds, law, rank = balance.bounds, lin.qp.friction, problem.comm.rank
    x, z, own = solved.x.array_r, solved.z.array_r, du.local_size
    pull = 0.0 if balance.friction is None else -float(balance.friction @ du.array_r)
    travel, drives = found.travel, lin.drives
    if travel is not None:
        x = x - travel @ drives.motions
        pull -= float(drives.loads @ travel) if rank == 0 else 0.0
    slip: Floats = np.zeros((0, 1))
    slide, limits = slip, slip[:, 0]
    if law is not None and balance.limits is not None:
        closed = solved.active[law.normal] > 0
        pressing = np.where(closed, z[bounds.dofs][law.normal], 0.0)
        slip, slide, limits = balance.limits.slip, law.pick(x), law.limit(pressing)
    # reactions times round-off of gaps and supports; residual of the QP
    held = balance.reduced.array_r[balance.equal.dofs]
    local = np.abs(z[bounds.dofs]).sum() + np.abs(held).sum() + limits.sum()
    touching = problem.comm.allreduce(float(local))
    unbalanced = round_off(problem.u, lin.diagonal) + solved.kkt.unsolved
    lost = gap_round_off(problem.u)
    yielded = 0.0 if balance.give is None else balance.give * np.maximum(z[bounds.dofs], 0.0)
    return Path(
        start=problem.u.x.array[:own].copy(),
        du=du.array_r.copy(),
        motion=x[bounds.dofs],
        gap=bounds.upper + lost + yielded,
        penalty=2.0 * multiplier * bounds.weight,
        noise=unbalanced * du.norm() + lost * touching,
        slip=slip,
        slide=slide,
        limits=limits,
        pull=pull,
        curve=lambda t: 0.0 if travel is None else drives.curve(t * travel),
    )


def find_slope(problem: ContactProblem, lin: Linearisation, path: Path) -> float:
    """Slope phi'(0), with the whole decrease of the penalty; collective.

    A solution of the QP closes violated gaps in proportion to t.
    """
    forces = lin.balance.r.array_r
    if lin.balance.friction is not None:  # its work is in the excess
        forces = forces - lin.balance.friction
    local = -float(forces @ path.du) + path.excess(1.0) - path.excess(0.0)
    return float(problem.comm.allreduce(local))
