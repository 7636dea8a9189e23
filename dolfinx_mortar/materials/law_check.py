# SPDX-License-Identifier: MIT
"""Check of a law at one point."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

import ufl
from dolfinx_mortar import arguments
from dolfinx_mortar.arrays import EPS, Floats, Ints
from dolfinx_mortar.kernels import compile_vectors, constants
from dolfinx_mortar.materials.logarithmic import LogarithmicLaw
from dolfinx_mortar.materials.protocol import PLASTIC, Law, create_law, grouped, named_parameters
from dolfinx_mortar.materials.response import (
    PointValues,
    elastic_response,
    respond,
    solve_normal_strain,
    values_at_points,
)
from dolfinx_mortar.materials.tensor import INDEX, mean_of_shears
from ufl.core.expr import Expr

PATHS = 8
SIZES = tuple(np.geomspace(1e-5, 1.0, 6))
# Largest errors: laws that iterate to 1e-6 pass.
RTOL = 1e-5
FINITE_RTOL = 1e-7
# Relative lengths of differences; elastic up to E / Y = 1e6.
LENGTHS = tuple(EPS**power for power in (1 / 5, 1 / 3, 0.45))
WEIGHTS = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}  # central differences of sixth order
STRETCHES = (  # scaled to a volume before use
    *((1.0, 1.0, 1.0), (1.0, 1.0, 2.0), (0.5, 1.0, 1.0), (1.0, 1.0 + 1e-9, 1.5)),
    *((1.0, 1.0 + 1e-5, 1.0 - 1e-5), (1.0, 1.001, 0.7), (0.5, 1.1, 2.2), (0.4, 0.9, 3.0)),
)
VOLUMES = (0.3, 1.0, 3.0)

State = Mapping[str, Floats]


@dataclass(frozen=True)
class LawReport:
    """Result of `check`; errors are relative to the elastic stress or moduli."""

    law: str
    samples: int  # pairs of strain and state, kinks excluded
    changed: int  # samples in which an internal variable changed
    energy_error: float  # stress against differences of the energy; NaN without an energy
    tangent_error: float  # tangent against differences of the stress
    state_error: float  # stress after a commit against that before
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
    if judge.point.finite:
        changed = judge.virgin
        for F in _gradients(judge.rng, float(size)):
            state = judge(F, judge.virgin)
            flows = judge.found[-1]["changed"]
            if changed is not judge.virgin:
                judge(F, changed)
            changed = state if flows else changed
    else:
        for _ in range(PATHS):
            state = judge.virgin
            for norm in float(size) * np.array(SIZES):
                state = judge(norm * _unit(judge.rng), state)
    return judge.report()


def _gradients(rng: np.random.Generator, size: float) -> Iterator[Floats]:
    for share in SIZES:
        yield np.eye(3) + share * size * rng.uniform(-1.0, 1.0, (3, 3))
    for J in VOLUMES:
        for stretches in STRETCHES:
            scaled = np.array(stretches) * (J / np.prod(stretches)) ** (1 / 3)
            yield _rotation(rng) @ np.diag(scaled) @ _rotation(rng)


def _rotation(rng: np.random.Generator) -> Floats:
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return np.asarray(Q * np.linalg.det(Q))


def _unit(rng: np.random.Generator, *, symmetric: bool = True) -> Floats:
    A = rng.standard_normal((3, 3))
    A += A.T if symmetric else 0.0
    return np.asarray(A / np.linalg.norm(A))


class Point(NamedTuple):
    """Response at one strain, or F, and state."""

    energy: float
    stress: Floats
    tangent: Floats
    state: dict[str, Floats]


@dataclass(frozen=True)
class LawAtPoint:
    """A law as a function of numbers."""

    law: Law
    finite: bool  # whether it is one of F, else of a small strain
    elastic: Callable[[Floats], Floats]  # small strain (3, 3) -> C : strain (3, 3)
    evaluate: Callable[[Floats, State], PointValues]  # of one point

    @property
    def rtol(self) -> float:
        """The largest error that passes."""
        return FINITE_RTOL if self.finite else RTOL

    def __call__(self, strain: Floats, state: State) -> Point:
        """Evaluate the law at a strain or F (3, 3); a ValueError unless all is finite."""
        found = self.evaluate(strain, state)
        if found.undefined[0]:
            volume = f"J = {np.linalg.det(strain):.3g}, " if self.finite else ""
            remedy = ": it has to be defined wherever J > 0" if self.finite else ""
            raise ValueError(
                f"{self.law.name} gives NaN or infinity at {volume}{self.where(strain, state)}"
                f"{remedy}"
            )
        energy = np.nan if found.energy is None else float(found.energy[0])
        new = {name: value[0] for name, value in found.state.items()}
        return Point(energy, found.stress[0], found.tangent[0], new)

    def where(self, strain: Floats, state: State, **others: Floats) -> str:
        """Describe strain and state for a message."""
        values = {"F" if self.finite else "strain": strain, **state, **others}
        return ", ".join(f"{name} = {_written(value)}" for name, value in values.items())


def law_at_point(material: Any, law: Law, strain: str | None = None) -> LawAtPoint:
    """Law as a function of numbers; a ValueError for varying parameters and finite plane stress."""
    finite = (strain or law.strain) == "finite"
    if law.plane_stress and finite:
        raise ValueError("plane_stress is True: at finite strain a law is judged in space alone")
    given = _numbers_of(material)
    e, p = _symbols(given, (3, 3))
    (elastic,) = compile_vectors([_entries(elastic_response(law, e, p))])
    numbers = list(given.values())

    def elastic_stress(strain: Floats) -> Floats:
        return elastic(np.array([*strain.ravel(), *numbers])).reshape(3, 3)

    if finite and law.strain == "small":
        evaluate = _of_arrays(given, LogarithmicLaw(law, list(given)).values)
    elif law.update is not None:
        evaluate = _of_arrays(given, partial(values_at_points, law))
    else:
        evaluate = _of_ufl(law, given)
    return LawAtPoint(law, finite, elastic_stress, evaluate)


def _numbers_of(material: Any) -> dict[str, float]:
    numbers = {}
    for name, value in named_parameters(material).items():
        if isinstance(value, Expr) and not isinstance(value, ufl.Constant):
            raise ValueError(
                f"{type(material).__name__}: {name} = {value} depends on place; try the law "
                f"out with numbers, dataclasses.replace(law, {name}=...)."
            )
        numbers[name] = float(getattr(value, "value", value))
    return numbers


def _of_ufl(law: Law, given: Mapping[str, float]) -> Callable[[Floats, State], PointValues]:
    """Return a law in UFL as a function of numbers."""
    e, D, z, *rest, p = _symbols(given, (3, 3), (3, 3), (), *law.state.values())
    response = respond(
        law, e, dict(zip(law.state, rest, strict=True)), p, z if law.condensed else None
    )
    psi = ufl.as_ufl(0.0) if response.energy is None else response.energy
    parts = [_entries(response.change(D)), _entries(response.stress), _entries(psi)]
    parts += [_entries(response.updated[name]) for name in law.state]
    if law.condensed:
        parts.append(ufl.as_vector(list(response.equation or [response.normal_strain])))
    change, *kernels = compile_vectors(parts)
    equation = kernels.pop() if law.condensed else None

    def evaluate(strain: Floats, state: State) -> PointValues:
        known = [np.ravel(state[name]) for name in law.state]
        numbers = np.concatenate([strain.ravel(), np.zeros(10), *known, list(given.values())])

        def at(rows: Ints, z: Floats) -> Floats:
            numbers[18] = z[0, 0]
            assert equation is not None
            return equation(numbers).reshape(1, 1, -1)

        if equation is not None and response.normal_strain is not None:
            numbers[18] = equation(numbers)[0]
        elif equation is not None:
            numbers[18] = solve_normal_strain(law.name, at, (1, 1))[0, 0]
        stress, energy, *new = (kernel(numbers) for kernel in kernels)
        columns = []
        for unit in np.eye(9):
            numbers[9:18] = unit
            columns.append(change(numbers))
        tangent = np.stack(columns, axis=1).reshape(1, 3, 3, 3, 3)
        tangent = tangent if law.strain == "finite" else mean_of_shears(tangent)
        shaped = zip(law.state.items(), new, strict=True)
        found = {name: value.reshape(1, *shape) for (name, shape), value in shaped}
        psi = None if law.energy is None else energy
        return PointValues(stress.reshape(1, 3, 3), tangent, found, energy=psi)

    return evaluate


def _of_arrays(
    given: Mapping[str, float], values: Callable[..., PointValues]
) -> Callable[[Floats, State], PointValues]:
    """Return a law of arrays as a function of numbers."""
    p = {name: np.array([value]) for name, value in given.items()}

    return lambda e, state: values(e[None], {n: np.array([v]) for n, v in state.items()}, p)


def _symbols(given: Mapping[str, float], *shapes: tuple[int, ...]) -> list[Any]:
    sizes = [int(np.prod(shape)) for shape in shapes]
    numbers = iter(list(constants(sum(sizes) + len(given))))
    found: list[Any] = []
    for shape, size in zip(shapes, sizes, strict=True):
        part = [next(numbers) for _ in range(size)]
        found.append(ufl.as_tensor([part[:3], part[3:6], part[6:]]) if shape else part[0])
    return [*found, grouped({name: next(numbers) for name in given})]


def _entries(value: Expr) -> Expr:
    entries = [value[i, j] for i in range(3) for j in range(3)] if value.ufl_shape else [value]
    return ufl.as_vector(entries)


class _Judge:
    """All comparisons; `found` has their errors."""

    def __init__(self, point: LawAtPoint, seed: int, rate_independent: bool) -> None:
        self.point, self._rate_independent = point, rate_independent
        self.rng, self._turns = (np.random.default_rng(s) for s in (seed, (seed, 1)))
        self.virgin: State = {name: np.zeros(shape) for name, shape in point.law.state.items()}
        self.found: list[dict[str, float]] = []
        probes = np.diag([1.0, 0.0, 0.0]), np.array([[0.0, 0.5, 0.0], [0.5, 0.0, 0.0], [0.0] * 3])
        self._stiffness = max(float(np.linalg.norm(point.elastic(e))) for e in probes)
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
            scale = max(float(np.linalg.norm(s)) for s in (here.stress, point.elastic(strain)))
            modulus = scale / length
        sample = _Sample(point, strain, state, here, scale)
        if law.linear:
            sample.demand(
                *("linear is True, but the tangent", here.tangent, self._start.tangent),
                *("at zero strain it is", float(np.linalg.norm(self._start.tangent))),
            )
        if not point.finite:
            sample.demand("the stress", here.stress, here.stress.T, "mirrored it is", scale)
        D = _unit(self.rng, symmetric=not point.finite)
        energy, tangent = sample.compare_differences(D, length, modulus)
        found = {"energy": energy, "tangent": tangent, "highest": 1.0}
        found["changed"] = any(np.any(here.state[name] != state[name]) for name in state)
        skew = here.tangent - here.tangent.transpose(2, 3, 0, 1)
        found["skew"] = float(np.abs(skew).max()) / modulus
        if not point.finite:
            found["lowest"], found["highest"] = _extreme_moduli(here.tangent)
            if self._rate_independent:
                told = "after a commit at the same strain it is"
                found["kept"] = sample.compare(told, strain, here.state, here.state)
            if law.isotropic and not law.plane_stress:
                found["isotropy"] = sample.compare_elastic(_rotation(self._turns))
        elif state is self.virgin:  # tensors that a law remembers may turn with it
            Q, told = _rotation(self.rng), "since a rotation strains nothing (write psi in C = F^T "
            found["objectivity"] = sample.compare(
                f"{told}F) it should be", Q @ strain, state, {}, Q
            )
        self.found.append(found)
        return here.state

    def report(self) -> LawReport:
        """Return the largest errors of all samples."""
        kept = [found for found in self.found if not np.isnan(found["tangent"])]
        if len(kept) < len(self.found) / 2:
            raise ValueError(
                f"{self.point.law.name}: differences of the stress by steps of several lengths "
                f"disagree with each other at {len(self.found) - len(kept)} of {len(self.found)} "
                "strains and states, so that no tangent fits: the stress has noise, as of "
                "iterations that end too early, or kinks everywhere"
            )

        def largest(name: str, none: float = np.nan) -> float:
            return float(np.fmax.reduce([found.get(name, none) for found in kept]))

        highest = largest("highest")
        lowest = min(found.get("lowest", 0.0) for found in kept)
        return LawReport(
            self.point.law.name,
            samples=len(kept),
            changed=sum(bool(found["changed"]) for found in kept),
            energy_error=largest("energy"),
            tangent_error=largest("tangent"),
            state_error=largest("kept", 0.0),
            skew=largest("skew"),
            lowest=lowest / highest if highest > 0.0 else 0.0,
            objectivity_error=largest("objectivity"),
            isotropy_error=largest("isotropy"),
        )


@dataclass(frozen=True)
class _Sample:
    point: LawAtPoint
    strain: Floats
    state: State
    here: Point
    scale: float

    def demand(
        self, what: str, given: Any, wanted: Any, other: str, scale: float, **places: Floats
    ) -> float:
        """Relative error; a ValueError with both values if too large."""
        given, wanted = np.asarray(given), np.asarray(wanted)
        errors = np.abs(given - wanted)
        worst = np.unravel_index(errors.argmax(), errors.shape)
        if not errors[worst] <= self.point.rtol * scale:
            entry = " " * bool(worst) + "".join("xyz"[i] for i in worst)
            raise ValueError(
                f"{self.point.law.name}: {what}{entry} is {given[worst]:.8g}, but {other} "
                f"{wanted[worst]:.8g}, at {self.point.where(self.strain, self.state, **places)}"
            )
        return float(errors[worst] / scale) if scale > 0.0 else 0.0

    def compare_differences(self, D: Floats, length: float, modulus: float) -> tuple[float, float]:
        """Return the errors of stress : D and tangent : D; NaN on kinks."""
        slopes, changes, here = [], [], self.here
        for share in LENGTHS:
            step, slope, change = share * length, 0.0, np.zeros((3, 3))
            for k, weight in WEIGHTS.items():
                for m in (k, -k):
                    at = self.point(self.strain + m * step * D, self.state)
                    slope += np.sign(m) * weight / step * at.energy
                    change += np.sign(m) * weight / step * at.stress
            slopes.append(slope)
            changes.append(change)
        energy_error, rtol = np.nan, self.point.rtol
        given = np.asarray(np.tensordot(here.tangent, D), dtype=np.float64)
        if not np.isnan(here.energy):
            work, why = (here.stress * D).sum(), "differences of the energy give"
            slope = min(slopes, key=lambda value: abs(value - work))
            energy_error = self.demand("the stress times D", work, slope, why, self.scale, D=D)

        def apart(one: Floats, other: Floats) -> float:
            return float(np.abs(one - other).max()) / modulus

        nearest = min(changes, key=lambda value: apart(value, given))
        if apart(nearest, given) > rtol and min(apart(*p) for p in pairwise(changes)) > rtol:
            return energy_error, np.nan
        what = "dP/dF : D" if self.point.finite else "the tangent along D"
        why = "differences of the stress give"
        return energy_error, self.demand(what, given, nearest, why, modulus, D=D)

    def compare(
        self,
        told: str,
        strain: Floats,
        state: State,
        wanted: State,
        left: Floats | None = None,
        right: Floats | None = None,
    ) -> float:
        """Return the error of a response that should be the present one, turned."""
        after, stress = self.point(strain, state), self.here.stress
        stress = stress if left is None else left @ stress
        stress = stress if right is None else stress @ right.T
        for name, value in wanted.items():
            changes = (value, value - self.state[name]) if left is None else (value, strain)
            size = max(float(np.abs(change).max()) for change in changes)
            self.demand(f"the state {name}", value, after.state[name], told, size)
        if self.point.finite and not np.isnan(after.energy):
            self.demand("psi(Q F)", after.energy, self.here.energy, told, self.scale)
        what = "P(Q F)" if self.point.finite else "the stress"
        return self.demand(what, after.stress, stress, told, self.scale)

    def compare_elastic(self, Q: Floats) -> float:
        """Return the error of the response to the elastic strain alone, turned by Q."""
        plastic = self.state.get(PLASTIC, np.zeros((3, 3)))
        state, new = dict(self.state), dict(self.here.state)
        if PLASTIC in state:
            state[PLASTIC] = 0.0 * plastic
            new[PLASTIC] = Q @ (new[PLASTIC] - plastic) @ Q.T
        told = "isotropic is True, but of the turned elastic strain it is"
        return self.compare(told, Q @ (self.strain - plastic) @ Q.T, state, new, Q, Q)


def _extreme_moduli(tangent: Floats) -> tuple[float, float]:
    roots = np.sqrt([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # Mandel's notation
    rows, columns = zip(*INDEX, strict=True)
    matrix = roots[:, None] * tangent[rows, columns][:, rows, columns] * roots
    values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    return float(values[0]), float(np.abs(values).max())


def _written(values: Any) -> str:
    return np.array2string(np.asarray(values), precision=8).replace("\n", "")
