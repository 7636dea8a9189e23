# SPDX-License-Identifier: MIT
"""Check of a law at one point."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.common import arguments
from dolfinx_mortar.common.arrays import EPS, Floats
from dolfinx_mortar.materials.logarithmic import CompiledLaw, LogarithmicLaw
from dolfinx_mortar.materials.protocol import (
    PLASTIC,
    Law,
    create_law,
    grouped,
    named_parameters,
)
from dolfinx_mortar.materials.response import PointValues, elastic_response
from dolfinx_mortar.materials.tensor import INDEX
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

PATHS = 8
SIZES = tuple(np.geomspace(1e-5, 1.0, 6))
# Largest errors: laws that iterate to 1e-6 pass.
RTOL = 1e-5
FINITE_RTOL = 1e-7
# Relative lengths of differences; elastic up to E / Y = 1e6.
LENGTHS = tuple(EPS**power for power in (1 / 5, 1 / 3, 0.45))
# Central differences of sixth order, at -3 to 3 steps.
WEIGHTS = np.array([-1 / 60, 3 / 20, -3 / 4, 0.0, 3 / 4, -3 / 20, 1 / 60])
STRETCHES = (  # scaled to a volume before use
    *((1.0, 1.0, 1.0), (1.0, 1.0, 2.0), (0.5, 1.0, 1.0), (1.0, 1.0 + 1e-9, 1.5)),
    *((1.0, 1.0 + 1e-5, 1.0 - 1e-5), (1.0, 1.001, 0.7), (0.5, 1.1, 2.2), (0.4, 0.9, 3.0)),
)
VOLUMES = (0.3, 1.0, 3.0)

State = Mapping[str, Floats]  # (1,) or (1, 3, 3)


@dataclass(frozen=True)
class LawReport:
    """Result of `check`; errors are relative to the elastic stress or moduli."""

    law: str
    samples: int  # pairs of strain and state, kinks excluded
    changed: int  # samples in which an internal variable changed
    energy_error: float  # stress against differences of the energy; NaN without an energy
    tangent_error: float  # tangent against differences of the stress
    state_error: float  # stress after a commit against that before; NaN where not compared
    skew: float  # largest antisymmetric part of the tangent
    lowest: float  # smallest eigenvalue of the tangent, relative to the largest of all samples
    # psi and P at Q F against psi and Q P at F, Q a rotation; NaN for a small strain
    objectivity_error: float = float("nan")
    # response to rotated strains without plastic strain; NaN for laws that are not `isotropic`
    isotropy_error: float = float("nan")

    def __str__(self) -> str:
        errors = {
            "stress against differences of the energy": self.energy_error,
            "tangent against differences of the stress": self.tangent_error,
            "stress kept by the update of the state": self.state_error,
            "energy and stress turn with the body": self.objectivity_error,
            "response to turned elastic strains": self.isotropy_error,
        }
        lines = [
            f"{self.law}: consistent at {self.samples} strains and states, in {self.changed} of "
            "which an internal variable changes",
            *(f"  {what:42} {error:.1e}" for what, error in errors.items() if error == error),
        ]
        if self.skew > RTOL:
            lines.append(
                f"  the tangent is not symmetric ({self.skew:.1e}): the linear solvers of this "
                "package need a symmetric one"
            )
        if self.lowest < -RTOL:
            lines.append(
                f"  the potential is not convex: the tangent has an eigenvalue {self.lowest:.1e} "
                "times the largest one; steps may have several solutions or none, and the solvers "
                "of this package need a definite tangent"
            )
        return "\n".join(lines)


def check(
    law: Any,
    *,
    size: float = 0.1,
    seed: int = 1,
    rate_independent: bool = True,
    plane_stress: bool = False,
    strain: str | None = None,
    initial_stress: bool = False,
) -> LawReport:
    """Compare stress, energy, tangent and state of a law at random strains and states.

    At small strains, on random paths from the virgin state with steps that grow over five decades
    up to `size`; at finite strain, at stretches and J from .3 to 3.

    * The virgin state must be free of stress.
    * d energy / d strain must be the stress, d stress / d strain the tangent, by differences of
      sixth order to 1e-5, at finite strain to 1e-7.
    * At finite strain energy and stress must rotate with F.
    * With `linear`, the tangent must be the same everywhere.
    * The tangent should be positive, or the potential is not convex (reported, no error).
    * At small strains a commit must change neither stress nor internal variables at the same
      strain.
    * With `isotropic`, rotations of the elastic strain must rotate stress and increment of the
      plastic strain, and keep scalars.

    Args:
        law: a material with parameters of a real problem.
        size: Frobenius norm of the largest small strain.
        seed: of the random strains.
        rate_independent: False omits the check after a commit, for laws that depend on time.
        plane_stress: check the law in plane stress.
        strain: "finite" checks the law as in ``Solid(.., strain="finite")``; by default the strain
            of the law itself.
        initial_stress: True for a law with stress in the virgin state.

    Returns:
        The largest errors.

    Raises:
        ValueError: for a wrong argument; where the law does not fit, with strain, state and both
            values.
    """
    parts = create_law("law", law, plane_stress=plane_stress)
    arguments.check("size", size, arguments.number("the norm of a strain,", above=0.0))
    arguments.check("seed", seed, arguments.integer(0))
    arguments.check_optional("strain", strain, arguments.one_of(parts.strain, "finite"))
    judge = _Judge(law_at_point(law, parts, strain), seed, rate_independent)
    if not initial_stress:
        judge.check_start()
    for path in _paths(judge.point, judge.rng, float(size)):
        state = judge.virgin
        for at in path:
            state = judge(at, state)
    return judge.report()


def _paths(
    point: "LawAtPoint", rng: np.random.Generator, size: float
) -> Iterable[Iterable[Floats]]:
    """Small strains, or F, to be passed from the virgin state on."""
    if not point.finite:
        return ([size * share * _unit(rng) for share in SIZES] for _ in range(PATHS))
    ends = [np.eye(3) + size * share * rng.uniform(-1.0, 1.0, (3, 3)) for share in SIZES]
    for J in VOLUMES:
        for stretches in np.array(STRETCHES):
            scaled = stretches * np.cbrt(J / stretches.prod())
            ends.append(_rotation(rng) * scaled @ _rotation(rng))
    return pairwise([*ends, ends[0]]) if point.law.state else zip(ends)


def _rotation(rng: np.random.Generator) -> Floats:
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return Q * np.linalg.det(Q)


def _unit(rng: np.random.Generator, *, symmetric: bool = True) -> Floats:
    A = rng.standard_normal((3, 3))
    A += A.T if symmetric else 0.0
    return A / np.linalg.norm(A)


@dataclass(frozen=True)
class LawAtPoint:
    """A law as a function of numbers."""

    law: Law
    finite: bool  # whether it is one of F, else of a small strain
    parameters: Mapping[str, float]
    elastic: Floats  # (9, 9), strain @ elastic is the elastic stress, entries row by row
    values: Callable[..., PointValues]  # see `CompiledLaw.values`

    @property
    def rtol(self) -> float:
        """The largest error that passes."""
        return FINITE_RTOL if self.finite else RTOL

    def __call__(self, strains: Floats, state: State) -> PointValues:
        """Values at q strains or F (.., 3, 3) from one state; a ValueError unless all is finite."""
        strains = strains.reshape(-1, 3, 3)
        q = len(strains)
        p = {name: np.full(q, value) for name, value in self.parameters.items()}
        found = self.values(strains, {n: np.repeat(v, q, axis=0) for n, v in state.items()}, p)
        for strain in strains[found.undefined]:
            volume = f"J = {np.linalg.det(strain):.3g}, " if self.finite else ""
            remedy = ": it has to be defined wherever J > 0" if self.finite else ""
            raise ValueError(
                f"{self.law.name} gives NaN or infinity at {volume}{self.where(strain, state)}"
                f"{remedy}"
            )
        return found

    def where(self, strain: Floats, state: State, **others: Floats) -> str:
        """Describe strain and state for a message."""
        values = {"F" if self.finite else "strain": strain, **state, **others}
        return ", ".join(f"{name} = {_written(value)}" for name, value in values.items())


def law_at_point(material: Any, law: Law, strain: str | None = None) -> LawAtPoint:
    """Law as a function of numbers; a ValueError for varying parameters and finite plane stress."""
    finite = (strain or law.strain) == "finite"
    if law.plane_stress and finite:
        raise ValueError("plane_stress is True: at finite strain a law is judged in space alone")
    given = {}
    for name, value in named_parameters(material).items():
        if isinstance(value, Expr) and not isinstance(value, ufl.Constant):
            raise ValueError(
                f"{law.name}: {name} = {value} depends on place; try the law "
                f"out with numbers, dataclasses.replace(law, {name}=...)."
            )
        given[name] = float(getattr(value, "value", value))
    p = grouped({name: ufl.as_ufl(value) for name, value in given.items()})
    units = (ufl.as_matrix(unit.tolist()) for unit in np.eye(9).reshape(9, 3, 3))
    elastic = np.empty((9, 9))
    for k, stress in enumerate(elastic_response(law, unit, p) for unit in units):
        elastic[k] = [expand_derivatives(stress[at])(()) for at in np.ndindex(3, 3)]

    if finite and law.strain == "small":
        return LawAtPoint(law, finite, given, elastic, LogarithmicLaw(law, list(given)).values)
    dimension = 2 if law.plane_stress else 3
    compiled = CompiledLaw(law, list(given), dimension=dimension, whole=True)
    return LawAtPoint(law, finite, given, elastic, compiled.values)


class _Judge:
    """All comparisons; `found` has their errors."""

    def __init__(self, point: LawAtPoint, seed: int, rate_independent: bool) -> None:
        self.point, self._rate_independent = point, rate_independent
        self.rng, self._turns = (np.random.default_rng(s) for s in (seed, (seed, 1)))
        self.virgin: State = {name: np.zeros((1, *of)) for name, of in point.law.state.items()}
        self.found: list[dict[str, float]] = []
        probes = point.elastic[0], (point.elastic[1] + point.elastic[3]) / 2
        self._stiffness = max(float(np.linalg.norm(stress)) for stress in probes)
        self._start = point(np.eye(3) * point.finite, self.virgin)

    def check_start(self) -> None:
        """Raise ValueError for stress in the virgin state."""
        stress = self._start.stress
        if np.abs(stress).max() > self.point.rtol * self._stiffness:
            raise ValueError(
                f"{self.point.law.name}: the stress at "
                f"{'F = I' if self.point.finite else 'zero strain'} is {_written(stress)}, not 0, "
                "so bodies strain without loads: a term is missing, as -2 ln J beside tr C - 3; "
                "if it is meant, say initial_stress=True"
            )

    def __call__(self, strain: Floats, state: State) -> State:
        """Check at a strain, or F; return the state at the end of the step."""
        point, law, here = self.point, self.point.law, self.point(strain, state)
        if point.finite:
            scale = modulus = max(self._stiffness, float(np.abs(here.tangent).max()))
            length = float(np.linalg.svd(strain, compute_uv=False).min())
        else:
            length = float(np.linalg.norm(strain))
            stresses = here.stress, strain.ravel() @ point.elastic
            scale = max(float(np.linalg.norm(stress)) for stress in stresses)
            modulus = scale / length
        sample = _Sample(point, strain, state, here, scale)
        if law.linear:
            sample.demand(
                *("linear is True, but the tangent", here.tangent, self._start.tangent),
                *("at zero strain it is", float(np.linalg.norm(self._start.tangent))),
            )
        if not point.finite:
            mirrored = here.stress.swapaxes(1, 2)
            sample.demand("the stress", here.stress, mirrored, "mirrored it is", scale)
        D = _unit(self.rng, symmetric=not point.finite)
        found = sample.compare_differences(D, length, modulus)
        found["changed"] = any(np.any(here.state[name] != state[name]) for name in state)
        skew = here.tangent - here.tangent.transpose(0, 3, 4, 1, 2)
        found["skew"] = float(np.abs(skew).max()) / modulus
        if not point.finite:
            found["lowest"], found["highest"] = _extreme_moduli(here.tangent[0])
            if self._rate_independent:
                told = "after a commit at the same strain it is"
                found["state_error"] = sample.compare(
                    *(told, strain, here.state, here.stress, here.state)
                )
            if law.isotropic and not law.plane_stress:
                found["isotropy_error"] = sample.compare_elastic(_rotation(self._turns))
        elif state is self.virgin:  # tensors that a law remembers may turn with it
            Q = _rotation(self.rng)
            told = "since a rotation strains nothing (write psi in C = F^T F) it should be"
            found["objectivity_error"] = sample.compare(told, Q @ strain, state, Q @ here.stress)
        self.found.append(found)
        return here.state

    def report(self) -> LawReport:
        """Return the largest errors of all samples."""
        kept = [found for found in self.found if not np.isnan(found["tangent_error"])]
        if len(kept) < len(self.found) / 2:
            raise ValueError(
                f"{self.point.law.name}: differences of the stress by steps of several lengths "
                f"disagree with each other at {len(self.found) - len(kept)} of {len(self.found)} "
                "strains and states, so that no tangent fits: the stress has noise, as of "
                "iterations that end too early, or kinks everywhere"
            )

        largest = {
            name: float(np.fmax.reduce([found.get(name, np.nan) for found in kept]))
            for name in ("highest", "skew", *(n for n in LawReport.__annotations__ if "error" in n))
        }
        highest, lowest = largest.pop("highest"), min(found.get("lowest", 0.0) for found in kept)
        return LawReport(
            self.point.law.name,
            samples=len(kept),
            changed=sum(bool(found["changed"]) for found in kept),
            lowest=lowest / highest if highest > 0.0 else 0.0,
            **largest,
        )


@dataclass(frozen=True)
class _Sample:
    point: LawAtPoint
    strain: Floats
    state: State
    here: PointValues
    scale: float

    def demand(
        self, what: str, given: Any, wanted: Any, other: str, scale: float, **places: Floats
    ) -> float:
        """Relative error; a ValueError with both values if too large."""
        given, wanted = np.squeeze(given), np.squeeze(wanted)
        errors = np.abs(given - wanted)
        worst = np.unravel_index(errors.argmax(), errors.shape)
        if not errors[worst] <= self.point.rtol * scale:
            entry = " " * bool(worst) + "".join("xyz"[i] for i in worst)
            raise ValueError(
                f"{self.point.law.name}: {what}{entry} is {given[worst]:.8g}, but {other} "
                f"{wanted[worst]:.8g}, at {self.point.where(self.strain, self.state, **places)}"
            )
        return float(errors[worst] / scale) if scale > 0.0 else 0.0

    def compare_differences(self, D: Floats, length: float, modulus: float) -> dict[str, float]:
        """Errors of stress : D and tangent : D, of this NaN on kinks."""
        slopes, changes, here = [], [], self.here
        for share in LENGTHS:
            step = share * length
            offsets = step * np.arange(-3.0, 4.0)[:, None, None]
            at, weights = self.point(self.strain + offsets * D, self.state), WEIGHTS / step
            slopes.append(np.nan if at.energy is None else float(weights @ at.energy))
            changes.append(np.tensordot(weights, at.stress, 1))
        found, rtol = {"tangent_error": np.nan}, self.point.rtol
        given = np.asarray(np.tensordot(here.tangent[0], D), dtype=np.float64)
        if here.energy is not None:
            work, why = (here.stress * D).sum(), "differences of the energy give"
            slope = min(slopes, key=lambda value: abs(value - work))
            found["energy_error"] = self.demand(
                "the stress times D", work, slope, why, self.scale, D=D
            )

        def apart(one: Floats, other: Floats) -> float:
            return float(np.abs(one - other).max()) / modulus

        nearest = min(changes, key=lambda value: apart(value, given))
        if apart(nearest, given) <= rtol or min(apart(*p) for p in pairwise(changes)) <= rtol:
            what = "dP/dF : D" if self.point.finite else "the tangent along D"
            why = "differences of the stress give"
            found["tangent_error"] = self.demand(what, given, nearest, why, modulus, D=D)
        return found

    def compare(
        self,
        told: str,
        strain: Floats,
        state: State,
        stress: Floats,
        wanted: State = MappingProxyType({}),
    ) -> float:
        """Return the error of a response that should have this stress and state."""
        after = self.point(strain, state)
        for name, value in wanted.items():
            size = max(float(np.abs(v).max()) for v in (value, value - self.state[name]))
            self.demand(f"the state {name}", value, after.state[name], told, size)
        if self.point.finite and after.energy is not None:
            self.demand("psi(Q F)", after.energy, self.here.energy, told, self.scale)
        what = "P(Q F)" if self.point.finite else "the stress"
        return self.demand(what, after.stress, stress, told, self.scale)

    def compare_elastic(self, Q: Floats) -> float:
        """Return the error of the response to the elastic strain alone, turned by Q."""
        plastic = self.state.get(PLASTIC, np.zeros((1, 3, 3)))
        state, new = dict(self.state), dict(self.here.state)
        if PLASTIC in state:
            state[PLASTIC] = 0.0 * plastic
            new[PLASTIC] = Q @ (new[PLASTIC] - plastic) @ Q.T
        told = "isotropic is True, but of the turned elastic strain it is"
        strain, stress = (Q @ tensor @ Q.T for tensor in (self.strain - plastic, self.here.stress))
        return self.compare(told, strain, state, stress, new)


def _extreme_moduli(tangent: Floats) -> tuple[float, float]:
    roots = np.sqrt([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # Mandel's notation
    rows, columns = zip(*INDEX, strict=True)
    matrix = roots[:, None] * tangent[rows, columns][:, rows, columns] * roots
    values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    return float(values[0]), float(np.abs(values).max())


def _written(values: Any) -> str:
    return np.array2string(np.squeeze(values), precision=8).replace("\n", "")
