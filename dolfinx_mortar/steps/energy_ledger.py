# SPDX-License-Identifier: MIT
"""The ledger of energies of a motion, and the energy that contact restores.

The impulse s of the contact forces is that of theory.md, Motion in time; it is postponed until more
than rtol of the largest energy is to be restored. Moving tools do work as supports; w and the
kinetic energy are relative to the tool. No impulse acts at tools driven by loads. Changes of
eigenstrain or parameters do the work Psi - Psi_n - 1/2 (F + F_n).(u - u_n), F the internal forces,
which counts as work of loads.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, ratio
from dolfinx_mortar.common.arrays import ROUND_OFF, Bools, Floats
from dolfinx_mortar.common.step_report import Ledger, Note, StepReport
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.solid.term import Term
from dolfinx_mortar.steps.subproblem import respond
from dolfinx_mortar.terms.inertia import FORCES, Damping, Inertia

# Smallest defect with a note: on impacts of a rod with a wall and a bar, velocities are wrong by
# 0.4 to 0.7 of the defect.
LARGE_DEFECT = 0.01


@dataclass(frozen=True)
class Impulse:
    """An impulse of the contact forces after a step."""

    velocity: Floats | float = 0.0  # change (owned nodes, d)
    time: float = 0.0  # factor of the forces of both ends
    supports: float = 0.0  # work of tools
    friction: float = 0.0  # work
    left: float = 0.0  # energy that it cannot add
    why: str = "Its forces are too small along the motion for the impulse that restores the energy"


class EnergyLedger:
    """The ledger of a problem with inertia, step by step.

    Without a potential "stored" is the work of the internal forces, dissipation included.
    """

    def __init__(self, problem: ContactProblem, inertia: Inertia, *, conserve: bool) -> None:
        """Begin or continue; contact restores energy if `conserve`; collective."""
        self.problem, self.inertia, self.conserve = problem, inertia, conserve
        history = problem.history
        last = history[-1].report.ledger if history else None
        stored = self.problem.solid.potential()
        if last is None:
            kinetic = inertia.kinetic_energy()
            total = kinetic + (stored or 0.0)
            impulses: list[list[float] | None] = [None] * len(problem.interfaces)
            energies = {"kinetic": kinetic, "stored": stored or 0.0, "largest": total}
            last = Ledger(total, **energies, impulses=impulses)
        named = problem.terms.named
        self._damped = [(name, term) for name, term in named if isinstance(term, Damping)]
        self._still = [one for one in named if not isinstance(one[1], Inertia | Damping)]
        self._acting = self._resultants()
        self.last, self._potential = last, stored
        self._began, self._heated = problem.owned_u.copy(), False
        self._inner = self._internal()

    def _resultants(self) -> list[Floats | None]:
        """Forces (d,) on slave sides that can open, else None."""
        zero = np.zeros(self.problem.d)
        return [
            (zero if one.resultants is None else one.force.copy()) if one.unilateral else None
            for one in self.problem.interfaces
        ]

    def _impulses(self, restored: float) -> list[list[float] | None]:
        before, self._acting = self._acting, self._resultants()
        time = 0.5 * self.inertia.start.dt + restored
        return [
            None
            if start is None or end is None
            else [*map(float, time * (start + end) + (0.0 if sum_ is None else np.array(sum_)))]
            for start, end, sum_ in zip(before, self._acting, self.last.impulses, strict=True)
        ]

    def _forces(self, named: Sequence[tuple[str, Term]]) -> Floats:
        F = self.problem.vector()
        self.problem.terms.add_forces(named, F)
        return F.array_r.reshape(self.inertia.mass.X.shape).copy()

    def _inside(self) -> Floats:
        return self._forces([("solid", self.problem.solid)])

    def _internal(self) -> Floats | None:
        plain = self._potential is not None and not self.problem.solid.points.follows
        return None if plain else self._inside()

    def start(self, begin: float, end: float, sides: Floats) -> None:
        """Find the acceleration M a = P^T (f - F + c) under the loads of the start; collective.

        P^T moves forces from massless nodes. `begin` and `end` are times of the first step, `sides`
        (owned nodes, d) the forces of rigid sides.
        """
        problem, inertia = self.problem, self.inertia
        problem.terms.prepare(self._still, begin, end)
        loads, velocity = -self._forces(self._still), inertia.values("velocity")
        damping = np.zeros_like(velocity)
        for _, term in self._damped:
            damping += term.times(velocity)
        forces = loads - self._inside() + sides - damping
        forces += inertia.values("contact") + inertia.values("friction")
        held = problem.supports.owned
        acting = inertia.mass.inner(np.where(held, 0.0, forces))
        acceleration = inertia.mass.solve(acting, held)
        balance = inertia.mass.times(acceleration)
        inertia.put(acceleration=acceleration, balance=balance, load=loads, damping=damping)
        if problem.committed.supports is not None:
            inertia.put(supports=problem.committed.supports.forces)

    def open(self) -> None:
        """Note the start of a step, whose loads are set; collective."""
        self._began, self._heated = self.problem.owned_u.copy(), False
        if self._potential is not None and self.problem.solid.points.follows:
            self._heated = self.problem.solid.potential() != self._potential

    def _sum(self, array: Floats) -> float:
        return self.inertia.sum(array.sum())

    def commit(self, report: StepReport) -> None:
        """Commit a converged step, and add its ledger to the report; collective."""
        problem, inertia, outcome = self.problem, self.inertia, self.problem.outcome
        supports, shape = problem.committed.supports, inertia.mass.X.shape
        assert outcome is not None and supports is not None
        assert outcome.normal is not None and outcome.tangential is not None
        before, u = self._began.reshape(shape), problem.owned_u.reshape(shape)
        acting = -self._forces(self._still), self._forces(self._damped)
        ends = outcome.normal, outcome.tangential, supports.forces, *acting
        after, motion, du = dict(zip(FORCES, ends, strict=True)), inertia.end(), u - before
        twice = {name: inertia.values(name) + values for name, values in after.items()}
        work = {name: self._sum(0.5 * values * du) for name, values in twice.items()}
        # the work of a moving tool on the bodies is no gain of contact
        way = self._tool_way(before, u)
        for name in FORCES[:2]:
            share = self._sum(0.5 * twice[name] * way)
            work[name] -= share
            work["supports"] += share
        gain = work["contact"] + max(work["friction"], 0.0)
        forces = [np.where(self._driven, 0.0, twice[name]) for name in FORCES[:2]]
        takes, slides = (self._sum(0.5 * f * (du - way)) for f in forces)
        terms = self._sum(np.abs(twice["contact"] * du))
        impulse, owed = Impulse(), self.last.owed + takes + max(slides, 0.0)
        least = max(ROUND_OFF * terms, report.rtol * self.last.largest)
        if self.conserve and abs(owed) > least:
            impulse = self._impulse(motion["velocity"], forces, way, -owed, report.rtol)
            work["supports"] += impulse.supports
            work["friction"] += impulse.friction
            owed = 0.0
        motion["velocity"] = motion["velocity"] + impulse.velocity
        inertia.finish(**motion, **after)
        impulses = self._impulses(impulse.time)
        potential = problem.solid.potential()
        problem.commit()
        last, (stored, flow, heat) = self.last, self._in_bodies(du, potential)
        ledger = replace(
            last,
            kinetic=inertia.kinetic_energy(),
            stored=stored,
            dissipated=last.dissipated + flow,
            friction=last.friction + max(-work["friction"], 0.0),
            damping=last.damping + work["damping"],
            loads=last.loads + work["load"] + heat,
            supports=last.supports + work["supports"],
            contact=last.contact + gain,
            owed=owed if self.conserve else 0.0,
            impulses=impulses,
        )
        self.last = report.ledger = _balanced(ledger)
        if report.certificate is not None:
            report.certificate = replace(report.certificate, energy_defect=self.last.defect)
        left = float(ratio(impulse.left, self.last.largest))
        if abs(left) > report.rtol:
            what = "taken from the bodies without giving it back"
            what = what if left > 0.0 else "given to the bodies"
            seen = f"in this step contact has {what} {100 * abs(left):.2g} % of the energy"
            why = f"{impulse.why}: take shorter steps, or some damping"
            report.notes.append(Note(seen, why))
        report.notes += notes_on_energy(self.last)

    def _in_bodies(self, du: Floats, potential: float | None) -> tuple[float, float, float]:
        """Stored energy, dissipation and heat of a step."""
        inner, start = 0.0, self._potential
        began, self._inner = self._inner, self._internal()
        if began is not None and self._inner is not None:
            inner = self._sum(0.5 * (began + self._inner) * du)
        if potential is None or start is None:
            return self.last.stored + inner, 0.0, 0.0
        heat = potential - start - inner if self._heated else 0.0
        stored = self._potential = self.problem.solid.potential() or 0.0
        return stored, potential - stored, heat

    @property
    def _driven(self) -> Bools:
        """Nodes (owned nodes, 1) on sides with tools driven by loads."""
        on = np.zeros((len(self.inertia.mass.X), 1), dtype=bool)
        system = self.problem.system
        for sides, interface in zip(system.sides, system.interfaces, strict=True):
            if interface.driven() is not None:
                on[sides.nodes] = True
        return on

    def _tool_way(self, before: Floats, after: Floats) -> Floats:
        """Motion (owned nodes, d) of touching tools at the nodes."""
        X, way = self.inertia.mass.X, np.zeros_like(before)
        # a later one overrules: of kept nodes, then of those before in the list
        for kept in (False, True):
            for link in reversed(self.problem.system.unilateral):
                nodes = link.nodes[link.coupling.kept[:, 0] | (not kept)]
                x, tool = X[nodes], link.interface.tool
                way[nodes] = 0.0
                if tool is not None:
                    way[nodes] = tool.way(x + before[nodes], x + after[nodes])
        return way

    def _impulse(
        self,
        velocity: Floats,
        forces: Sequence[Floats],
        way: Floats,
        energy: float,
        rtol: float,
    ) -> Impulse:
        """Impulse of the forces of contact and friction that adds an energy; collective."""
        problem, mass, sums, start = self.problem, self.inertia.mass, self._sum, self.inertia.start
        moved = list[Floats]()
        for f in forces:
            acts = any_rank(problem.comm, f.any())[0]
            y = respond(problem, f, rtol) if acts else np.zeros_like(f)
            if y is None:
                why = "The linear solver found no response to the impulse that restores the energy"
                return Impulse(left=energy, why=why)
            moved.append(mass.extend(y))
        whole = moved[0] + moved[1]
        images = [mass.times(y) for y in moved]
        # per unit of y
        tools, drags = (sums(f * way) / (start.kappa * start.dt) for f in forces)
        a = sums(whole * images[0])
        b = sums(velocity * images[0]) - tools
        if not a > 0.0:
            return Impulse(left=energy)
        root = b**2 + 2.0 * a * energy
        s = 2.0 * energy / (b + np.copysign(np.sqrt(root), b)) if root > 0.0 else -b / a
        dragged = s * (sums((velocity + 0.5 * s * whole) * images[1]) - drags)
        left = min(root, 0.0) / (2.0 * a)
        return Impulse(s * whole, s / start.kappa, s * (tools + drags), dragged, left)


def _balanced(ledger: Ledger) -> Ledger:
    gone = ledger.dissipated + ledger.friction + ledger.damping
    total = ledger.kinetic + ledger.stored
    largest = max(ledger.largest, total, gone, abs(ledger.loads), abs(ledger.supports))
    return replace(ledger, largest=largest, defect=float(ratio(ledger.imbalance, largest)))


def notes_on_energy(ledger: Ledger) -> list[str]:
    """Notes on an energy defect."""
    if abs(ledger.defect) <= LARGE_DEFECT:
        return []
    what = "appeared" if ledger.defect > 0.0 else "been lost"
    seen = f"{100 * abs(ledger.defect):.2g} % of the energy has {what} in the steps so far"
    why = (
        "See report.ledger: the steps are too large for what moves in them (waves, impacts, "
        "rotations, plastic flow), or spectral_radius < 1 damps it; halve the steps and compare. "
        "Bodies of one or two layers of cells keep the mass of their contact nodes, with which "
        "impacts do not keep the energy: mesh them with three layers or more"
    )
    return [Note(seen, why)]
