# SPDX-License-Identifier: MIT
"""Checks of a law of the deformation gradient: energy, P, dP/dF, rotations."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.arrays import EPS, Floats
from dolfinx_mortar.kernels import compile_vectors
from dolfinx_mortar.materials.compiled import (
    at_one_point,
    compile_elastic,
    entries,
    of_one_point,
    parameters,
    state_entries,
    stored_shapes,
    symbols,
)
from dolfinx_mortar.materials.finite_law import Evaluation, create_finite_law
from dolfinx_mortar.materials.logarithmic import LogarithmicLaw
from dolfinx_mortar.materials.protocol import Law
from dolfinx_mortar.materials.ranges import grouped
from dolfinx_mortar.materials.response import respond

# Differences of sixth order have round-off alone: hyperelastic laws show 2e-12, those of a small
# strain 1e-11, plastic ones 7e-8 at most, near kinks, at E / Y up to 1000 (six seeds).
RTOL = 1e-7
# Of finite differences, relative to the strain or the smallest stretch. The long one survives the
# round-off of formulas that cancel. At the second truncation and round-off of central differences
# are equal, and fewer of them go across a kink, where a law yields. The third stays inside the
# yield surface of a body that only changes its volume up to E / Y = 1e6, with a round-off of 5e-8
# at most.
LENGTHS = tuple(EPS**power for power in (1 / 5, 1 / 3, 0.45))
SIZES = tuple(np.geomspace(1e-5, 1.0, 6))  # of strains, over five decades
WEIGHTS = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}  # central differences of sixth order
STEPS = [k for m in WEIGHTS for k in (-m, m)]
STRETCHES = (  # before they are scaled to a volume
    *((1.0, 1.0, 1.0), (1.0, 1.0, 2.0), (0.5, 1.0, 1.0), (1.0, 1.0 + 1e-9, 1.5)),
    *((1.0, 1.0 + 1e-5, 1.0 - 1e-5), (1.0, 1.001, 0.7), (0.5, 1.1, 2.2), (0.4, 0.9, 3.0)),
)
VOLUMES = (0.3, 1.0, 3.0)


@dataclass(frozen=True)
class FinitePoint:
    """What a law gives at one F and state, in numbers."""

    energy: float  # NaN without one
    stress: Floats  # (3, 3) P
    tangent: Floats  # (3, 3, 3, 3) dP/dF
    state: dict[str, Floats]  # () or (6,)


At = Callable[[Floats, Mapping[str, Floats]], FinitePoint]


@dataclass(frozen=True)
class FiniteLawErrors:
    """What `compare_at_finite_strain` found, relative to the elastic stress or moduli."""

    samples: int  # pairs of F and state, without those on a kink
    changed: int  # samples in which an internal variable changed
    energy: float  # P against differences of the energy; NaN without an energy
    tangent: float
    turned: float  # psi(Q F) - psi(F) and P(Q F) - Q P(F)
    skew: float


def gradients(rng: np.random.Generator, size: float) -> Iterator[Floats]:
    """Yield deformation gradients: small ones, and large ones with coincident stretches."""
    for share in SIZES:
        yield np.eye(3) + share * size * rng.uniform(-1.0, 1.0, (3, 3))
    for J in VOLUMES:
        for stretches in STRETCHES:
            scaled = np.array(stretches) * (J / np.prod(stretches)) ** (1 / 3)
            yield rotation(rng) @ np.diag(scaled) @ rotation(rng)


def rotation(rng: np.random.Generator) -> Floats:
    """Return a random rotation (3, 3)."""
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return np.asarray(Q * np.linalg.det(Q))


def law_at_points(material: Any, law: Law) -> tuple[At, float, bool]:
    """Return a law as a function of one F and state, its stiffness, and whether it has an energy.

    The stiffness is the norm of the elastic stress of unit strains.
    """
    given = parameters(material)
    elastic = compile_elastic(law, given)
    probes = ([1, 0, 0, 0, 0, 0], [0, 0, 0, 0.5, 0, 0])
    norms = [float(np.linalg.norm(elastic(np.array([*e, *given.values()])))) for e in probes]
    stiffness = max(norms)
    if law.strain == "finite" and law.update is None:
        return _compiled(law, given), stiffness, law.energy is not None
    if law.strain == "small":
        logarithmic = LogarithmicLaw(law, list(given))
        return _of_arrays(law, given, logarithmic.evaluate), stiffness, logarithmic.has_energy
    finite = create_finite_law(law)
    return _of_arrays(law, given, finite.evaluate), stiffness, finite.has_energy


def _compiled(law: Law, given: Mapping[str, float]) -> At:
    """Return a law in UFL as a function of one F and state."""
    shapes = stored_shapes(law)
    F, D, *rest = symbols((3, 3), (3, 3), *shapes.values(), *[()] * len(given))
    state = dict(zip(shapes, rest, strict=False))
    p = grouped(dict(zip(given, rest[len(state) :], strict=True)))
    response = respond(law, F, state, p)
    parts = [entries(response.stress), entries(response.change(D))]
    parts.append([ufl.as_ufl(0.0) if response.energy is None else response.energy])
    parts += state_entries(response, shapes)
    stress, change, energy, *new_state = compile_vectors([ufl.as_vector(p) for p in parts])

    def at(gradient: Floats, committed: Mapping[str, Floats]) -> FinitePoint:
        rest = np.concatenate(
            [*(np.atleast_1d(committed[n]) for n in shapes), list(given.values())]
        )
        first = np.concatenate([gradient.ravel(), np.zeros(9), rest])
        columns = [np.concatenate([gradient.ravel(), e, rest]) for e in np.eye(9)]
        tangent = np.stack([change(c) for c in columns], axis=1)
        values = [kernel(first) for kernel in new_state]
        new = {n: v if shapes[n] else v[0] for n, v in zip(shapes, values, strict=True)}
        psi = np.nan if response.energy is None else float(energy(first)[0])
        return FinitePoint(psi, stress(first).reshape(3, 3), tangent.reshape(3, 3, 3, 3), new)

    return at


def _of_arrays(law: Law, given: Mapping[str, float], evaluate: Evaluation) -> At:
    """Return a law of arrays, or one of a small strain, as a function of one F and state."""

    def at(gradient: Floats, committed: Mapping[str, Floats]) -> FinitePoint:
        found = evaluate(gradient[None], *at_one_point(law.state, committed, given))
        psi = np.nan if found.energy is None else float(found.energy[0])
        return FinitePoint(psi, found.stress[0], found.tangent[0], of_one_point(found.state))

    return at


def compare_at_finite_strain(
    material: Any, law: Law, rng: np.random.Generator, size: float, *, initial_stress: bool
) -> FiniteLawErrors:
    """Compare energy, P and dP/dF of a law at random F, and its answer to rotations.

    At each F from the virgin state, and from one that has changed at another F.

    Raises:
        ValueError: where they do not fit, with F and both values.
    """
    evaluate, stiffness, has_energy = law_at_points(material, law)
    at = _finite_only(law, evaluate, has_energy)
    virgin = {n: np.zeros(6 if shape else ()) for n, shape in law.state.items()}
    if not initial_stress:
        check_start(law, at(np.eye(3), virgin).stress, RTOL * stiffness)
    found, tried, flowed = [], 0, virgin
    for F in gradients(rng, size):
        for state in [virgin] if flowed is virgin else [virgin, flowed]:
            here = at(F, state)
            scale = max(stiffness, float(np.abs(here.tangent).max()))
            sample = _Sample(law, at, F, state, here, scale, has_energy)
            derivatives = sample.compare_with_differences(rng.uniform(-1.0, 1.0, (3, 3)))
            # tensors that a law remembers may turn with the body
            turned = sample.compare_turned(rotation(rng)) if state is virgin else 0.0
            changed = any(np.any(here.state[n] != state[n]) for n in state)
            tried += 1
            if derivatives is not None:
                found.append((changed, *derivatives, turned, sample.skew()))
            if changed and state is virgin:
                flowed = here.state
    if len(found) < tried / 2:
        raise ValueError(
            f"{law.name}: differences of P by steps of several lengths disagree with each other at "
            f"{tried - len(found)} of {tried} deformation gradients, so that no tangent fits: P "
            "has noise, as of iterations that end too early, or kinks everywhere"
        )
    changed_, *errors = np.array(found, dtype=float).T
    return FiniteLawErrors(len(found), int(changed_.sum()), *(float(e.max()) for e in errors))


def _finite_only(law: Law, evaluate: At, has_energy: bool) -> At:
    """Return the function that raises ValueError where a law gives NaN or infinity."""

    def at(F: Floats, state: Mapping[str, Floats]) -> FinitePoint:
        point = evaluate(F, state)
        values = [point.stress, point.tangent, *point.state.values()]
        values += [np.array(point.energy)] if has_energy else []
        if not all(np.isfinite(value).all() for value in values):
            raise ValueError(
                f"{law.name} gives NaN or infinity at J = {np.linalg.det(F):.3g}, "
                f"F = {_written(F)}: it has to be defined wherever J > 0"
            )
        return point

    return at


@dataclass(frozen=True)
class _Sample:
    """A law at one F and state."""

    law: Law
    at: At
    F: Floats  # (3, 3)
    state: Mapping[str, Floats]
    here: FinitePoint  # what the law gives there
    scale: float  # a modulus: errors are relative to it
    has_energy: bool

    def compare_with_differences(self, D: Floats) -> tuple[float, float] | None:
        """Return the errors of P : D and dP/dF : D (D (3, 3)) against differences along D.

        None where no two lengths of differences of P agree, as on a kink: they tell nothing.
        """
        work, change = (self.here.stress * D).sum(), np.tensordot(self.here.tangent, D)
        smallest_stretch = float(np.linalg.svd(self.F, compute_uv=False).min())
        slopes, differences = [], []
        for length in LENGTHS:
            step = length * smallest_stretch
            points = {k: self.at(self.F + k * step * D, self.state) for k in STEPS}
            slopes.append(_difference({k: point.energy for k, point in points.items()}, step))
            differences.append(_difference({k: point.stress for k, point in points.items()}, step))
            energy_error, slope = self._nearest(slopes, work)
            tangent_error, difference = self._nearest(differences, change)
            if np.nanmax([energy_error, tangent_error]) <= RTOL:
                return energy_error, tangent_error
        if self.has_energy:
            self._demand("P : D", energy_error <= RTOL, work, slope)
        if min(self._nearest([a], b)[0] for a, b in pairwise(differences)) > RTOL:
            return None
        self._demand("dP/dF : D", tangent_error <= RTOL, change, difference)
        return energy_error, tangent_error

    def _nearest(self, found: list[Any], wanted: Any) -> tuple[float, Any]:
        """Return the smallest error, relative to the scale, and of which value it is."""
        errors = [float(np.abs(value - wanted).max()) / self.scale for value in found]
        best = int(np.argmin(errors))
        return errors[best], found[best]

    def compare_turned(self, Q: Floats) -> float:
        """Return the error of energy and stress at Q F, Q a rotation (3, 3)."""
        turned, stress = self.at(Q @ self.F, self.state), Q @ self.here.stress
        off = [np.abs(turned.stress - stress).max()]
        off += [abs(turned.energy - self.here.energy)] if self.has_energy else []
        error = float(max(off)) / self.scale
        why = "as Q P(F), since a rotation strains nothing: write psi in C = F^T F"
        self._demand("P(Q F), Q a rotation,", error <= RTOL, turned.stress, stress, why)
        return error

    def skew(self) -> float:
        """Return how unsymmetric the tangent is."""
        tangent = self.here.tangent
        return float(np.abs(tangent - tangent.transpose(2, 3, 0, 1)).max()) / self.scale

    def _demand(
        self, what: str, holds: Any, given: Any, wanted: Any, why: str = "by differences"
    ) -> None:
        """Raise ValueError, with F and both values, unless something holds."""
        if not holds:
            place, *both = (_written(v) for v in (self.F, given, wanted))
            raise ValueError(
                f"{self.law.name}: {what} is {both[0]}, but should be {both[1]} ({why}) at F = "
                f"{place}{''.join(f', {n} = {_written(v)}' for n, v in self.state.items())}"
            )


def check_start(law: Law, stress: Floats, tolerance: float) -> None:
    """Raise ValueError if a law has a stress (3, 3) before anything has moved."""
    if np.abs(stress).max() > tolerance:
        where = "F = I" if law.strain == "finite" else "zero strain"
        raise ValueError(
            f"{law.name}: the stress at {where} is {_written(stress)}, not 0, so bodies strain "
            "without loads: a term is missing, as -2 ln J beside tr C - 3; if it is meant, say "
            "initial_stress=True"
        )


def _difference(values: Mapping[int, Any], step: float) -> Any:
    """Return the derivative from values at multiples of a step."""
    return sum(w * (values[k] - values[-k]) for k, w in WEIGHTS.items()) / step


def _written(values: Any) -> str:
    """Return an array in one line."""
    return np.array2string(np.asarray(values), precision=8).replace("\n", "")
