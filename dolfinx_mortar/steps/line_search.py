# SPDX-License-Identifier: MIT
"""The length of a Newton step: whole, a half, a quarter .., until the merit falls.

The merit is phi(t) = J(u + t du) + s sum_j D_jj (t w_j - gap_j)_+ with the gaps of one geometry,
with friction also + sum_j s_j |slip_j + t dw_j|, s_j the limits of the QP's solution. A
step is accepted if phi falls by a share of what its slope promises (Armijo), or rises by no more
than the round-off of its own terms: there the values say nothing, and the residuals judge.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.qp import QPSolution
from dolfinx_mortar.steps.linearisation import Linearisation
from dolfinx_mortar.steps.problem import ContactProblem
from dolfinx_mortar.steps.residuals import EPS, gap_round_off, round_off
from dolfinx_mortar.steps.step_data import StepData

ARMIJO = 1e-4
MAX_HALVINGS = 12


class NoDescent(RuntimeError):
    """No step along the direction lowers the merit."""


@dataclass(frozen=True)
class Energy:
    """J(u) and the size of its terms."""

    value: float
    terms: float  # sum of the absolute values of what is added up


def find_energy(problem: ContactProblem, data: StepData) -> Energy:
    """Return J(u) = Psi(u) - f.u; collective."""
    psi, potential = problem.solid.energy(), problem.loads.energy()
    work = data.f.array_r * problem.u.x.array[: data.f.local_size]
    local = np.array([work.sum(), np.abs(work).sum()])
    total, size = problem.comm.allreduce(local, op=MPI.SUM)
    return Energy(psi + potential - total, abs(psi) + abs(potential) + size)


@dataclass(frozen=True)
class Direction:
    """A step to be shortened: u + t du, y + t dy, with what phi needs besides J."""

    start: Floats  # (n,) u
    du: Floats  # (n,)
    motion: Floats  # (k,) of the bounded unknowns
    gap: Floats  # (k,) beyond which they are penalised, round-off of gaps included
    penalty: Floats  # (k,) s D_jj
    noise: float  # error of r.du: round-off of forces and gaps, and what the QP has left
    slip: Floats  # (m, d - 1) of nodes with friction, at the start
    slide: Floats  # (m, d - 1) by how much they slip in the step
    limits: Floats  # (m,) what resists

    def excess(self, t: float) -> float:
        """Return the terms of penalty and friction at t; on this rank."""
        slips = np.linalg.norm(self.slip + t * self.slide, axis=1)
        over = np.maximum(t * self.motion - self.gap, 0.0)
        return float(self.penalty @ over + self.limits @ slips)


def search(
    problem: ContactProblem,
    data: StepData,
    lin: Linearisation,
    solved: QPSolution,
    du: PETSc.Vec,
    multiplier: float,
    before: Energy,
) -> tuple[float, int, Energy]:
    """Move u along a step until the merit falls; collective.

    Args:
        problem: the problem; its displacement is moved.
        data: loads of the step.
        lin: the linearisation that has led to the step.
        solved: the QP's solution.
        du: the same step in u.
        multiplier: largest multiplier seen; the penalty is twice as large.
        before: J at the start.

    Returns:
        The length, the number of halvings, and J at the end.

    Raises:
        NoDescent: if 12 halvings do not suffice.
    """
    path = create_path(problem, lin, solved, du, multiplier)
    cells = problem.V.mesh.topology.index_map(problem.V.mesh.topology.dim).size_global
    first = _sum(problem.comm, path.excess(0.0))
    promise = find_slope(problem, lin, path)
    length = 1.0
    for halvings in range(MAX_HALVINGS + 1):
        move(problem, path.start + length * path.du)
        after, penalty = find_energy(problem, data), _sum(problem.comm, path.excess(length))
        # a sum of n terms of one size loses about sqrt(n) units of round-off
        noise = EPS * np.sqrt(cells) * (before.terms + after.terms + first + penalty) + path.noise
        target = before.value + first + ARMIJO * length * min(promise, 0.0)
        if after.value + penalty <= target + noise:
            return length, halvings, after
        length *= 0.5
    move(problem, path.start)
    raise NoDescent("the line search found no step that lowers the energy")


def create_path(
    problem: ContactProblem,
    lin: Linearisation,
    solved: QPSolution,
    du: PETSc.Vec,
    multiplier: float,
) -> Direction:
    """Return the path from the present u along a step; collective."""
    bounds, own = lin.balance.bounds, du.local_size
    # reactions times the round-off of gaps and supports; what the QP has not balanced
    held = lin.balance.reduced.array_r[lin.balance.equal.dofs]
    slip, slide, limits = _friction(lin, solved)
    local = np.abs(solved.z.array_r[bounds.dofs]).sum() + np.abs(held).sum() + limits.sum()
    touching = _sum(problem.comm, float(local))
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
    )


def _friction(lin: Linearisation, solved: QPSolution) -> tuple[Floats, Floats, Floats]:
    """Return slip, its change, and the limits at the nodes with friction.

    For these limits the QP's solution minimises the convex energy with the term of friction, so
    that it is a direction of descent.
    """
    law, bounds = lin.qp.friction, lin.balance.bounds
    if law is None:
        return np.zeros((0, 1)), np.zeros((0, 1)), np.zeros(0)
    closed = solved.active[law.normal] > 0
    pressing = np.where(closed, solved.z.array_r[bounds.dofs][law.normal], 0.0)
    return -law.rest, law.pick(solved.x.array_r), law.limit(pressing)


def find_slope(problem: ContactProblem, lin: Linearisation, path: Direction) -> float:
    """Return what the start promises, phi'(0) with the whole gain of the penalty term; collective.

    A step that solves the QP closes every violated gap in proportion, so that the gain over the
    whole step is the derivative at its start.
    """
    local = -float(lin.balance.r.array_r @ path.du) + path.excess(1.0) - path.excess(0.0)
    return _sum(problem.comm, local)


def _sum(comm: MPI.Comm, value: float) -> float:
    return float(comm.allreduce(value, op=MPI.SUM))


def move(problem: ContactProblem, values: Floats) -> None:
    """Set the displacement to owned values; collective."""
    problem.u.x.array[: values.size] = values
    problem.u.x.scatter_forward()
