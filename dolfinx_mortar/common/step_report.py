# SPDX-License-Identifier: MIT
"""Report of a load step."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any


class Timings:
    """Wall-clock seconds of this rank by part of the work."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Add the time in the ``with`` block to ``part``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - start

    def since(self, earlier: dict[str, float]) -> dict[str, float]:
        """Seconds since a copy of ``seconds``."""
        return {k: v - earlier.get(k, 0.0) for k, v in self.seconds.items()}


class Note(str):
    """Observation of a step; ``why`` explains it and gives a remedy."""

    why: str

    def __new__(cls, seen: str, why: str = "") -> Note:
        """Create a note; copies lose ``why``."""
        note = super().__new__(cls, seen)
        note.why = why
        return note


@dataclass(frozen=True)
class Iteration:
    """One Newton iteration."""

    number: int
    increment: float  # |du|_e / (|u|_e + |u + du|_e), elastic energy norm
    force_residual: float  # projected, relative
    contact_residual: float  # penetration and complementarity, relative
    kkt: float  # penetration and complementarity, relative
    active: int  # active contact nodes, all interfaces and ranks
    changed: int  # changes of the active set without weakly active nodes
    updates: int  # iterations of the QP backend
    linear_iterations: int
    factorisations: int
    step_length: float  # accepted by the line search
    line_search_steps: int
    geometry_change: float  # gap minus its prediction by the last linearisation, in facet lengths
    shift: float = 0.0  # multiple of the elastic stiffness added to an indefinite tangent
    exact_tangent: bool = False  # whether moving surfaces were linearised

    def __str__(self) -> str:
        return (
            f"Newton {self.number:2d}: increment {self.increment:.2e}, "
            f"forces {self.force_residual:.2e}, contact {self.contact_residual:.2e}, "
            f"KKT {self.kkt:.1e}, active {self.active} ({self.changed:+d}), QP {self.updates}, "
            f"CG {self.linear_iterations}, factorisations {self.factorisations}, "
            f"step {self.step_length:.3g}, geometry {self.geometry_change:.1e}"
            + (f", tangent + {self.shift:g} elastic" if self.shift else "")
            + (", linearised" if self.exact_tangent else "")
        )


@dataclass(frozen=True)
class Certificate:
    """Residuals of a converged step, each relative to its own scale.

    Forces: the largest external, contact, reaction or element force; lengths: the mean slave facet;
    multipliers: the largest one; tangential reactions: the largest friction limit, their energies
    limits times slips. Small-strain errors are of the worst body.
    """

    equilibrium: float  # forces on free unknowns
    gap: float  # deepest violation of w_n <= gap
    sign: float  # largest tension: of a multiplier as pressure or force, or of a patch
    complementarity: float  # largest lambda_j * gap_j
    # |sum_j (s_j + t_j)| / sum_j |s_j|, s_j, t_j the forces on the slave and master side
    force_balance: float
    # the same for moments at X + u about the centre of slave forces, relative to sum_j |s_j| (|a_j|
    # + h), a_j the arms, h the facet length: O(h^2) on curved sides (theory.md, Moments)
    moment_balance: float
    linear_field_error: float  # tangential part of x_s - P x_m per gap + facet length
    row_sum_error: float  # largest row sum of D - M over D_jj
    smallest_coverage: float  # covered share of a kept node's tributary length
    kept_nodes: int
    removed_nodes: int  # without multiplier, whose dual function is distributed
    active_nodes: int
    active_set_changes: int
    newton_iterations: int
    qp_iterations: int
    line_search_steps: int
    geometry_change: float
    friction_cone: float = 0.0  # largest tangential reaction beyond its limit
    friction_stick: float = 0.0  # longest slip of a sticking node
    friction_work: float = 0.0  # limits times slips, less the dissipation
    friction_gain: float = 0.0  # largest energy that a node gains by friction
    left_out_strain: float = 0.0  # largest |H^T H| / 2, H = grad u, over the largest strain
    left_out_work: float = 0.0  # share of neglected rotations in a body's stress work
    left_out_lengths: float = 0.0  # mean of |H^T H| / 2 in a body
    rotation: float = 0.0  # largest rotation, radians
    loads: float = 0.0  # missing share of the load of a bolt, tool or rigid side
    crossing: float = 0.0  # penetration without an interface, in facets
    # at finite strain: moment at X + u of internal forces, over forces times arms
    internal_moment: float = 0.0
    smallest_J: float = 1.0  # smallest det F at integration points, 1 for small strains
    energy_defect: float = 0.0  # of `time_steps`, see `Ledger`


@dataclass(frozen=True)
class Ledger:
    """Energies of a motion at the end of a step, and works since its start.

    Of the whole ring, or per thickness. Works by the trapezoidal rule.

        kinetic + stored + dissipated + friction + damping = initial + loads + supports.
    """

    initial: float  # kinetic and stored energy at the start
    kinetic: float
    stored: float  # in the bodies; see `EnergyLedger`
    dissipated: float = 0.0  # by plastic flow
    friction: float = 0.0
    damping: float = 0.0  # dissipated by Rayleigh's damping
    loads: float = 0.0  # work of loads, other terms, temperature and parameters
    supports: float = 0.0  # work of supports, rigid sides and tools
    contact: float = 0.0  # work beyond friction, before the energy was restored
    defect: float = 0.0  # left minus right side, over the largest energy
    largest: float = 0.0  # largest of these energies and works
    owed: float = 0.0  # work given by contact, not yet restored
    # (d,) on the slave side of each contact since the start, with those that restored the energy
    impulses: list[list[float] | None] = field(default_factory=list)

    @property
    def imbalance(self) -> float:
        """Left minus right side."""
        gone = self.dissipated + self.friction + self.damping
        return self.kinetic + self.stored + gone - (self.initial + self.loads + self.supports)

    def __str__(self) -> str:
        energies = {name: value for name, value in vars(self).items() if name != "impulses"}
        return "energy: " + ", ".join(f"{name} {value:.6g}" for name, value in energies.items())


SUMS = "newton_iterations", "qp_iterations", "factorisations", "residual_history"


@dataclass
class StepReport:
    """Report of one load step; ``print`` shows a table."""

    converged: bool = False
    backend: str = ""  # ``qp``
    geometry: str = ""  # "updated" or "reference"
    linear_solver: str = ""  # in words
    friction: str = ""  # linearisation of friction
    rtol: float = 0.0
    iterations: list[Iteration] = field(default_factory=list)
    certificate: Certificate | None = None
    ledger: Ledger | None = None  # of `time_steps`
    cuts: int = 0  # failures of larger steps before, by `load_steps`
    notes: list[str] = field(default_factory=list)  # possible inaccuracies
    seconds: dict[str, float] = field(default_factory=dict)  # of this rank, by part

    @property
    def newton_iterations(self) -> int:
        """Number of linearisations."""
        return len(self.iterations)

    @property
    def qp_iterations(self) -> int:
        """Iterations of the QP backend."""
        return sum(it.updates for it in self.iterations)

    @property
    def factorisations(self) -> int:
        """Numerical factorisations (preconditioner set-ups)."""
        return sum(it.factorisations for it in self.iterations)

    @property
    def residual_history(self) -> list[float]:
        """Energy-norm increments, one per Newton iteration."""
        return [it.increment for it in self.iterations]

    def note_friction(self, number: int, linearisation: str) -> None:
        """Note the linearisation of friction, and from which iteration."""
        if not self.friction:
            self.friction = linearisation
        elif not self.friction.endswith(linearisation):
            self.friction += f", from iteration {number} on {linearisation}"

    def begin_anew(self) -> None:
        """Note a failed prediction, and clear the iterations."""
        self.notes.append(
            f"the motion of the last step led nowhere in {len(self.iterations)} iterations: this "
            "one began without it"
        )
        self.iterations.clear()
        self.linear_solver = ""

    def quote(self, number: int, text: str) -> None:
        """Note a message of the QP backend, if any."""
        if text:
            self.notes.append(f"iteration {number}: {text}")

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        return asdict(self) | {name: getattr(self, name) for name in SUMS}

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> StepReport:
        """Read the result of `as_dict`."""
        values = {name: value for name, value in given.items() if name not in SUMS}
        values["iterations"] = [Iteration(**iteration) for iteration in given["iterations"]]
        for name, kind in (("certificate", Certificate), ("ledger", Ledger)):
            values[name] = None if given[name] is None else kind(**given[name])
        return cls(**values)

    def __str__(self) -> str:
        state = "converged" if self.converged else "NOT converged"
        lines = [
            f"{state} in {self.newton_iterations} Newton iterations "
            f"({self.qp_iterations} QP, {self.factorisations} factorisations), "
            f"{self.geometry} geometry, {self.backend}, {self.linear_solver}"
            + (f", friction with {self.friction}" if self.friction else ""),
            *map(str, self.iterations),
        ]
        if self.certificate is not None:
            lines.append("certificate")
            for name, value in asdict(self.certificate).items():
                shown = f"{value:.2e}" if isinstance(value, float) else f"{value:d}"
                lines.append(f"  {name.replace('_', ' '):<22} {shown}")
        lines += [] if self.ledger is None else [str(self.ledger)]
        lines += [f"note: {note}" for note in self.notes]
        lines.append("seconds: " + ", ".join(f"{k} {v:.3f}" for k, v in self.seconds.items()))
        return "\n".join(lines)

    __repr__ = __str__


@dataclass(frozen=True)
class LoadStep:
    """A committed load or time step."""

    number: int
    time: float  # load level, or time, at its end
    report: StepReport  # of the last part
    parts: list[StepReport] = field(default_factory=list)  # several after cuts
    forces: list[list[float]] = field(default_factory=list)  # on the slave side of each interface
    # of each of problem.bcs: "force", "moment" and "about", see `Reaction`
    reactions: list[dict[str, Any]] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        parts = [part.as_dict() for part in self.parts]
        names = ("number", "time", "forces", "reactions")
        return {name: getattr(self, name) for name in names} | {"parts": parts}

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> LoadStep:
        """Read the result of `as_dict`."""
        parts = [StepReport.from_dict(part) for part in given["parts"]]
        results = given["forces"], given["reactions"]
        return cls(given["number"], given["time"], parts[-1], parts, *results)

    @property
    def outcome(self) -> str:
        """Result and cost in words."""
        iterations = sum(part.newton_iterations for part in self.parts)
        cut = f" in {len(self.parts)} parts" if len(self.parts) > 1 else ""
        certificate = self.report.certificate
        active = certificate.active_nodes if certificate is not None else 0
        return f"to {self.time:g}{cut}: {iterations} Newton iterations, {active} nodes in contact"

    def __str__(self) -> str:
        return f"step {self.number} {self.outcome}"

    __repr__ = __str__


class NewtonNotConverged(RuntimeError):
    """Newton's method failed; ``report`` has the details.

    The problem is as before the failed step or part: retry with a smaller one.
    """

    def __init__(self, message: str, report: StepReport) -> None:
        """Create the error."""
        super().__init__(message, report)
        self.message, self.report = message, report

    def __str__(self) -> str:
        return f"{self.message}\n{self.report}"
