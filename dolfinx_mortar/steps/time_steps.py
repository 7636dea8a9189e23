# SPDX-License-Identifier: MIT
"""Steps of dynamics: times, one after the other, with the ledger of energies."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, largest
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import check, number, one_of
from dolfinx_mortar.common.arrays import QUARTER_OF_DIGITS, ROUND_OFF, SAME, Floats
from dolfinx_mortar.common.step_report import LoadStep, NewtonNotConverged, StepReport
from dolfinx_mortar.heat import Heat
from dolfinx_mortar.persistence.committed import Before
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.steps.energy_ledger import EnergyLedger
from dolfinx_mortar.steps.walk import Level, Run
from dolfinx_mortar.terms.inertia import (
    IMPLICIT,
    MOTION,
    NEWMARK,
    Damping,
    Inertia,
    Scheme,
    generalised_alpha,
    has_square,
)

CONSERVING, DAMPED = "energy-conserving", "generalised-alpha"


class TimeRun(Run):
    """Steps in time, with a ledger."""

    name = "time step"
    conserve = True
    radius: float | None = None  # of "generalised-alpha"
    ledger: EnergyLedger | None = None
    notes: Sequence[str] = ()  # for the report of the first step

    def to(self, level: Level) -> StepReport:
        """Solve a step to a time; collective."""
        if self.ledger is not None:
            self.ledger.open()
            return super().to(level)
        problem = self.problem
        before = Before(problem.state, problem.outcome)
        with problem.undone(before):
            ledger = self._open(level)
            ledger.open()
            report = super().to(level)
            assert problem.outcome is not None  # before the start has settled
            problem.outcome = replace(problem.outcome, before=before)
        self.ledger = ledger
        return report

    def _open(self, level: Level) -> EnergyLedger:
        problem, begin = self.problem, self.problem.committed.level
        inertia, sides = find_inertia(problem), None
        goes_on = any(step.report.ledger is not None for step in problem.history[-1:])
        self.notes = [] if goes_on else stop_held(problem, inertia)
        self.load(begin)
        if not goes_on:
            sides = self._settle(inertia, begin, level)
        ledger = EnergyLedger(problem, inertia, conserve=self.conserve)
        if sides is not None:
            ledger.start(begin, level.time, sides)
        self.load(level.time)
        return ledger

    def _settle(self, inertia: Inertia, begin: float, level: Level) -> Floats:
        """Bring nodes without mass into equilibrium; return forces (owned nodes, d) on rigid sides.

        By a step from rest in a share h = 1e-4 of the first one: other nodes move by a share h^2.
        """
        problem, mass = self.problem, inertia.mass
        on_sides, forces = np.zeros_like(mass.massless), np.zeros_like(mass.X)
        for sides in problem.system.sides:
            on_sides[sides.nodes] |= sides.hold
        nodes = mass.massless | on_sides
        if not any_rank(problem.comm, nodes.any())[0]:
            return forces
        scheme = inertia.scheme
        before = {name: inertia.values(name).copy() for name in MOTION}
        inertia.put(**dict.fromkeys(MOTION, np.zeros_like(mass.X)))
        inertia.scheme = IMPLICIT
        part = begin + QUARTER_OF_DIGITS * (level.time - begin)
        try:
            super().to(replace(level, time=part))
            outcome = problem.outcome
            assert outcome is not None and outcome.normal is not None
            assert outcome.tangential is not None
            inertia.put(contact=outcome.normal, friction=outcome.tangential)
            inertia.roll_back()
            problem.outcome = replace(outcome, level=begin)
            problem.commit()
            assert problem.committed.supports is not None
            forces[on_sides] = problem.committed.supports.forces[on_sides]
        except NewtonNotConverged as error:
            self.notes = [
                *self.notes,
                "Inertia: nodes of contacts, which have no mass, found no equilibrium with the "
                f"loads of the start ({error.message.splitlines()[0]}): the first step knows no "
                "contact forces at its start",
            ]
        finally:
            problem.terms.roll_back()
            inertia.put(**before)
            inertia.scheme = scheme
        return forces

    def commit(self, report: StepReport) -> None:
        """Commit a step with its ledger; collective."""
        assert self.ledger is not None
        self.ledger.commit(report)
        report.notes += self.notes
        self.notes = ()

    def settings(self) -> dict[str, Any]:
        """Scheme and damping, for the comparison with a checkpoint."""
        terms = [term for _, term in self.problem.terms.named if isinstance(term, Damping)]
        return {
            "scheme": CONSERVING if self.conserve else DAMPED,
            "spectral_radius": self.radius,
            "Damping(mass, stiffness)": [term.shares for term in terms],
        }

    def may_cut(self) -> bool:
        """True: half the time is another problem."""
        return True


def time_steps(
    problem: ContactProblem,
    times: Iterable[float],
    *,
    scheme: str = CONSERVING,
    spectral_radius: float | None = None,
    ramp: Mapping[fem.Constant, Iterable[tuple[float, npt.ArrayLike]]] | None = None,
    on_time: Callable[[float], None] | None = None,
    start: float | None = None,
    qp: str = "active-set",
    rtol: float = 1e-6,
    max_it: int = 50,
    cuts: str = "halve",
    max_cuts: int = 6,
    progress: bool | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    every: int = 1,
    heat: Heat | None = None,
    dt: fem.Constant | None = None,
) -> Iterator[LoadStep]:
    """Step through time: set the loads, solve, commit, yield; collective.

        inertia = dm.Inertia(solid, 7.85e-9, velocity=(0.0, -227e3))
        problem = dm.ContactProblem(solid, [contact], bcs=bcs, terms=[inertia])
        for step in dm.time_steps(problem, np.linspace(0.0, 80e-6, 801)[1:]):
            print(step.time, step.report.ledger)

    With the trapezoidal rule a step of length dt minimises, within the bounds of contact, the
    incremental potential plus

        kappa/2 |u - p|_M^2,     kappa = 4 / dt^2,     p = u_n + dt v_n + dt^2/4 a_n,

    M being the mass matrix; for the generalised alpha method see `dolfinx_mortar.terms.inertia`.
    Bodies need no supports. The initial acceleration is that of the forces, loads and supports at
    ``start``, with nodes without mass in equilibrium. The initial velocity is set to 0 where a
    support does not move, with a note.

    Args:
        problem: bodies and constraints, with an `Inertia` among its terms.
        times: ends of the steps, increasing. If they begin with all those of the last run on this
            problem, as after `ContactProblem.restore`, that run goes on.
        scheme: "energy-conserving" is the trapezoidal rule, with an impulse of the contact forces
            after each step that restores the energy of contact: impacts conserve energy.
            "generalised-alpha" damps high frequencies.
        spectral_radius: of "generalised-alpha": the factor of the amplitude of the highest
            frequencies in each step, from 0 to 1, by default 0.8; 1 means no damping.
        ramp, on_time: as in `load_steps`, over time; also called for the start.
        start: time of the committed state; by default the last one reached, at first 0.
        qp, rtol, max_it: as in `newton`.
        cuts, max_cuts, progress, every: as in `load_steps`. A step is also cut where bodies would
            pass through each other.
        checkpoint: as in `load_steps`, with velocities and accelerations.
        heat, dt: as in `load_steps`.

    Yields:
        One ``LoadStep`` for every time, or remaining time of a continued run, with the `Ledger` of
        energies in its report.

    Raises:
        ValueError: unless the problem has one inertia and times increase; otherwise as
            `load_steps`.
        OSError, NewtonNotConverged: as `load_steps`.
    """
    given = times, ramp, on_time, start, cuts, max_cuts, progress, checkpoint, every, heat, dt
    run = TimeRun(problem, *given, qp=qp, rtol=rtol, max_it=max_it)
    check_same_on_all_ranks(problem.comm, scheme=scheme, spectral_radius=spectral_radius)
    history, done = problem.history, 0
    walked = [step.time for step in history[len(history) - problem.committed.walked :]]
    if start is None and len(walked) <= len(run.levels):  # the last run may go on
        size = max(map(abs, walked), default=0.0)
        pairs = zip(run.levels, walked, strict=False)
        done = len(walked) * all(abs(a - b) <= SAME * size for a, b in pairs)
    check_increasing(run.begin, run.levels[done:])
    found, run.radius = choose_scheme(scheme, spectral_radius)
    inertia = find_inertia(problem)
    problem.go_back()
    inertia.scheme, run.conserve = found, scheme == CONSERVING
    yield from run.steps(done)


def choose_scheme(scheme: Any, radius: Any) -> tuple[Scheme, float | None]:
    """Parameters of a scheme, and its spectral radius if it has one; or a ValueError."""
    if check("scheme", scheme, one_of(CONSERVING, DAMPED)) == CONSERVING:
        if radius is not None:
            raise ValueError(
                f"spectral_radius is {radius!r}, but {CONSERVING!r} damps nothing: leave it out, or"
                f" choose scheme={DAMPED!r}"
            )
        return NEWMARK, None
    given = 0.8 if radius is None else radius
    found = check("spectral_radius", given, number(least=0.0, most=1.0))
    return generalised_alpha(found), found


def stop_held(problem: ContactProblem, inertia: Inertia) -> list[str]:
    """Set the initial velocity to 0 where supports do not move in the first step; collective.

    The trapezoidal rule would change its sign in every step.
    """
    supports, velocity = problem.supports, inertia.values("velocity").copy()
    way = supports.increment(supports.values(), problem.u.x.array)
    size, speed = (largest(problem.comm, values) for values in (problem.u.x.array, velocity))
    still = supports.owned & (np.abs(way) <= ROUND_OFF * size)
    against = still & (np.abs(velocity) > ROUND_OFF * speed)
    stopped = largest(problem.comm, velocity[against])
    if stopped == 0.0:
        return []
    count = problem.comm.allreduce(int(against.any(axis=1).sum()))
    velocity[still] = 0.0
    inertia.put(velocity=velocity)
    return [
        f"Inertia: velocity is up to {stopped:.3g} at {count} nodes in directions that bcs hold; "
        "it has been set to 0 there, since it would change its sign in every step: give a velocity "
        "that vanishes where bcs hold, or move the support"
    ]


def check_increasing(begin: float, levels: list[float]) -> None:
    """Raise a ValueError unless times increase, in steps dt with dt and dt^2 in floating point."""
    for before, after in zip([begin, *levels], levels, strict=False):
        dt = after - before
        share = QUARTER_OF_DIGITS * dt  # of the settling of the start
        if not dt > 0.0:
            raise ValueError(
                f"times holds {after:g} after {before:g}: times must increase, from the start at "
                f"{begin:g} on (the start itself is no step)"
            )
        if before + share == before or not has_square(share) or not has_square(dt):
            raise ValueError(
                f"times holds {after:g}, {dt:g} after {before:g}: that is too short a step for the "
                "digits of numbers, or its square is infinite: give times in another unit, longer "
                "steps, or count from a nearer start"
            )


def find_inertia(problem: ContactProblem) -> Inertia:
    """The inertia of a problem; a ValueError unless one fits; collective."""
    found = [term for _, term in problem.terms.named if isinstance(term, Inertia)]
    if len(found) != 1:
        raise ValueError(
            f"problem has {len(found) or 'no'} Inertia among its terms: give it one, "
            "ContactProblem(.., terms=[dm.Inertia(solid, density)])"
        )
    inertia = found[0]
    if inertia.solid is not problem.solid:
        raise ValueError(
            "problem: its Inertia is that of another Solid: make it with problem.solid"
        )
    for name, term in problem.terms.named:
        if isinstance(term, Damping) and term.inertia is not inertia:
            raise ValueError(f"problem: {name} is that of another Inertia: make it with this one")
    same = np.array_equal(inertia.contact, problem.system.can_open[: problem.n])
    if any_rank(problem.comm, not same)[0]:
        raise ValueError(
            "problem: its Inertia is also in a problem that was made later with other contacts or "
            "ties, and has the mass of that one: make an Inertia for each problem"
        )
    return inertia
