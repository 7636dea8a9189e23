# SPDX-License-Identifier: MIT
"""Checks of a law: stress against energy, tangent against stress, state against stress."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dolfinx_mortar import arguments
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.materials.compiled import CompiledLaw, Point, PointwiseNumbers
from dolfinx_mortar.materials.finite_comparison import (
    LENGTHS,
    SIZES,
    check_start,
    compare_at_finite_strain,
)
from dolfinx_mortar.materials.protocol import PLASTIC, Law, create_law
from dolfinx_mortar.materials.tensor import COMPONENTS, INDEX, tensor_of

PATHS = 8  # random ones, with strains of all sizes on each
# The truncation of the longer differences is near 5e-7, which leaves a factor of 20 for curvature,
# and lets what laws iterate to 1e-6 pass. With the shorter ones the laws of this package have 2e-10
# at most (six seeds, strains to .3, E / Y from 670 to 1e5).
RTOL = 1e-5
SHEAR = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # how often a stored component is in a tensor


@dataclass(frozen=True)
class LawReport:
    """What `check` found; errors are relative to the elastic stress of the same strain."""

    law: str
    samples: int  # pairs of strain and state
    changed: int  # samples in which an internal variable changed
    energy_error: float  # stress against differences of the energy; NaN without an energy
    tangent_error: float  # tangent against differences of the stress
    state_error: float  # stress at the end of a step against that at the start of the next
    skew: float  # largest unsymmetric part of the tangent
    lowest: float  # smallest eigenvalue of the tangent, relative to the largest one anywhere
    # psi and P at Q F against psi and Q P at F, Q a rotation; NaN for a small strain
    objectivity_error: float = float("nan")
    # turned, without plastic strain, against what it was; NaN for laws that are not `isotropic`
    isotropy_error: float = float("nan")

    def __str__(self) -> str:
        lines = [
            f"{self.law}: consistent at {self.samples} strains and states, in {self.changed} of "
            "which an internal variable changes",
            f"  tangent against differences of the stress  {self.tangent_error:.1e}",
            f"  stress kept by the update of the state     {self.state_error:.1e}",
        ]
        if not np.isnan(self.objectivity_error):
            lines[-1] = f"  energy and stress turn with the body       {self.objectivity_error:.1e}"
        if not np.isnan(self.energy_error):
            lines.insert(1, f"  stress against differences of the energy   {self.energy_error:.1e}")
        if not np.isnan(self.isotropy_error):
            lines.append(
                f"  response to turned elastic strains            {self.isotropy_error:.1e}"
            )
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


@dataclass(frozen=True)
class _Sample:
    """A law at a strain and state, and how messages call the place."""

    law: CompiledLaw | PointwiseNumbers
    name: str
    strain: Floats  # (6,)
    state: Mapping[str, Floats]

    def at(self, strain: Floats, direction: Floats) -> Point:
        """Evaluate the law at the state of the sample; everything must be finite."""
        point = self.law(strain, direction, self.state)
        if not point.finite or (self.law.has_energy and not np.isfinite(point.energy)):
            raise ValueError(f"{self.name} gives NaN or infinity {self.where(strain)}")
        return point

    def where(self, strain: Floats | None = None) -> str:
        """Return the place in words."""
        values = [("strain", self.strain if strain is None else strain), *self.state.items()]
        return "at " + ", ".join(f"{n} = {_written(v)}" for n, v in values)

    def demand(self, what: str, given: Floats, wanted: Floats, other: str, scale: float) -> float:
        """Return the error of stored components relative to a scale.

        Raises:
            ValueError: if it is too large, with the component and both values.
        """
        errors = np.abs(np.atleast_1d(given - wanted))
        worst = int(errors.argmax())
        if not errors[worst] <= RTOL * scale:
            component = f" {COMPONENTS[3][worst]}" if len(errors) == 6 else ""
            values = np.atleast_1d(given)[worst], np.atleast_1d(wanted)[worst]
            raise ValueError(
                f"{self.name}: {what}{component} is {values[0]:.8g}, but {other} {values[1]:.8g}, "
                f"{self.where()} (components {', '.join(COMPONENTS[3])})"
            )
        return float(errors[worst] / scale) if scale > 0.0 else 0.0


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

    The law runs as compiled code, as in a solid, but without a mesh: along random strain paths from
    the virgin state, whose steps grow over five decades up to `size`. At each strain and state

    * there must be no stress at the start;
    * d energy / d strain by central differences must be the stress, where there is an energy;
    * d stress / d strain by central differences must be the tangent that UFL derives;
    * with `linear`, the tangent must be the same everywhere;
    * the tangent should be positive, or the potential of the step is not convex (told, no error);
    * the internal variables at the end of the step, committed, must give the same stress at the
      same strain, and stay as they are (not for laws that go on with time);
    * with `isotropic`, the elastic strain alone, turned, must give the turned stress, the same
      scalars and the turned increment of the plastic strain.

    Args:
        law: a material such as ``VonMises(...)``, with parameters of a real problem.
        size: Frobenius norm of the largest strain.
        seed: of the random strains.
        rate_independent: False leaves out the last comparison.
        plane_stress: judge what the law does in plane stress.
        strain: "finite" judges what the law does in ``Solid(.., strain="finite")``; the default is
            the strain that the law is made for. At deformation gradients from small ones to
            stretches of .3 to 3 and J from .3 to 3, with coincident stretches, d psi / dF has to be
            P and dP/dF its derivative, both by differences of sixth order to 1e-7, from the virgin
            state and from a changed one, and energy and stress have to turn with F.
        initial_stress: True for a law that is meant to have a stress before anything has moved.

    Returns:
        The largest errors found; ``print`` it.

    Raises:
        ValueError: naming a wrong argument; where the law does not fit, with strain, state,
            component and both values.
    """
    parts = create_law("law", law, plane_stress=plane_stress)
    _check_arguments(parts, size, seed, strain)
    rng, turns = (np.random.default_rng(s) for s in (seed, (seed, 1)))
    if (strain or parts.strain) == "finite":
        return _check_at_finite_strain(law, parts, rng, float(size), initial_stress)
    compiled = CompiledLaw(law, parts) if parts.update is None else PointwiseNumbers(law, parts)
    virgin = {n: np.zeros(shape) for n, shape in compiled.shapes.items()}
    start = _Sample(compiled, parts.name, np.zeros(6), virgin)
    if not initial_stress:
        _check_virgin(start, parts, float(size * SIZES[0]))
    judge = _Judge(parts, start, turns, rate_independent)
    found = []
    for _ in range(PATHS):
        state: Mapping[str, Floats] = virgin
        for norm in size * np.array(SIZES):
            along, first, second = (_unit(rng) for _ in range(3))
            sample = _Sample(compiled, parts.name, norm * along, state)
            errors, state = judge(sample, first, second)
            found.append(errors)
    return _report(parts.name, found)


def _check_arguments(parts: Law, size: float, seed: int, strain: str | None) -> None:
    """Raise ValueError unless the arguments of `check` make sense."""
    arguments.check("size", size, arguments.number("the norm of a strain,", above=0.0))
    arguments.check("seed", seed, arguments.integer(0))
    arguments.check_optional("strain", strain, arguments.one_of(parts.strain, "finite"))
    if parts.plane_stress and (strain or parts.strain) == "finite":
        raise ValueError("plane_stress is True: at finite strain a law is judged in space alone")


def _check_at_finite_strain(
    law: Any, parts: Law, rng: np.random.Generator, size: float, initial_stress: bool
) -> LawReport:
    """Judge a law by its response to deformation gradients."""
    found = compare_at_finite_strain(law, parts, rng, size, initial_stress=initial_stress)
    errors = (found.energy, found.tangent, 0.0, found.skew, 0.0, found.turned)
    return LawReport(parts.name, found.samples, found.changed, *errors)


def _check_virgin(start: _Sample, parts: Law, least: float) -> None:
    """Raise ValueError if there is a stress before anything has moved.

    Its tolerance is that share of the elastic moduli, at strains of the least size.
    """
    moduli = [start.at(least * e, e).elastic / least for e in np.eye(6)]
    stress = start.at(start.strain, start.strain).stress
    check_start(parts, stress, RTOL * float(np.abs(moduli).max()))


class _Errors(NamedTuple):
    """What was found at one sample; NaN for what does not apply."""

    changed: bool  # whether an internal variable changed
    energy: float
    tangent: float
    skew: float
    kept: float  # of the stress that the new state gives
    turned: float
    lowest: float  # smallest eigenvalue of the tangent
    highest: float  # largest one, without its sign


@dataclass(frozen=True)
class _Judge:
    """All comparisons at a sample."""

    parts: Law
    start: _Sample  # without strain, in the virgin state
    turns: np.random.Generator  # of rotations
    rate_independent: bool

    def __call__(
        self, sample: _Sample, first: Floats, second: Floats
    ) -> tuple[_Errors, Mapping[str, Floats]]:
        """Return the errors of a sample, and the state at the end of its step.

        The tangent is tried along the first direction, its symmetry with the second.
        """
        if self.parts.linear:
            _compare_with_start(sample, self.start, first)
        state = sample.at(sample.strain, first).state
        changed = any(np.any(state[n] != sample.state[n]) for n in state)
        derivatives = _compare(sample, first, second)
        kept = _compare_state(sample, state) if self.rate_independent else 0.0
        turned = np.nan
        if self.parts.isotropic and not self.parts.plane_stress:
            turned = _compare_turned(sample, np.linalg.qr(self.turns.standard_normal((3, 3)))[0])
        return _Errors(changed, *derivatives, kept, turned, *_extreme_moduli(sample)), state


def _report(name: str, found: list[_Errors]) -> LawReport:
    """Return the largest errors of all samples."""
    of = _Errors(*np.array(found, dtype=float).reshape(-1, len(_Errors._fields)).T)  # (samples,)
    highest = np.max(of.highest)
    return LawReport(
        name,
        samples=len(found),
        changed=int(np.sum(of.changed)),
        energy_error=float(np.max(of.energy)),
        tangent_error=float(np.max(of.tangent)),
        state_error=float(np.max(of.kept)),
        skew=float(np.max(of.skew)),
        lowest=float(np.min(of.lowest) / highest) if highest > 0.0 else 0.0,
        isotropy_error=float(np.max(of.turned)),
    )


def _compare(sample: _Sample, first: Floats, second: Floats) -> tuple[float, float, float]:
    """Return the errors of stress and tangent, and how unsymmetric the tangent is."""
    here, norm = sample.at(sample.strain, first), float(np.linalg.norm(sample.strain))
    scale = max(float(np.linalg.norm(here.stress)), float(np.linalg.norm(here.elastic)))
    mirrored = _components(here.stress.T)
    sample.demand("the stress", _components(here.stress), mirrored, "mirrored it is", scale)
    energy_error = np.nan
    if sample.law.has_energy:
        stress = _components(here.stress)
        slopes = _nearest([_energy_slopes(sample, t * norm) for t in LENGTHS], stress)
        energy_error = sample.demand(
            "the stress", stress, slopes, "differences of the energy give", scale
        )
    change = _components(here.change)
    tangent_error = sample.demand(
        f"the tangent along {_written(first)},",
        change,
        _nearest([_stress_change(sample, first, t * norm) for t in LENGTHS], change),
        "differences of the stress give",
        scale / norm,
    )
    across = sample.at(sample.strain, second)
    skew = _work(here.change, second) - _work(across.change, first)
    return energy_error, tangent_error, abs(skew) / (scale / norm)


def _extreme_moduli(sample: _Sample) -> tuple[float, float]:
    """Return the smallest eigenvalue of the symmetric part of the tangent, and the largest size."""
    root = np.sqrt(SHEAR)  # orthonormal components: products are those of the tensors
    columns = [root * _components(sample.at(sample.strain, e).change) for e in np.diag(1 / root)]
    matrix = np.array(columns)
    values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    return float(values[0]), float(np.abs(values).max())


def _energy_slopes(sample: _Sample, t: float) -> Floats:
    """Return d energy / d strain, stored components (6,), by central differences."""
    slopes = np.empty(6)
    for k in range(6):
        step = np.zeros(6)
        step[k] = t / SHEAR[k]  # the work of a stored shear counts twice
        above, below = (sample.at(sample.strain + s * step, step) for s in (1, -1))
        slopes[k] = (above.energy - below.energy) / (2 * t)
    return slopes


def _stress_change(sample: _Sample, direction: Floats, t: float) -> Floats:
    """Return d stress / d strain : direction, stored components (6,), by central differences."""
    above, below = (sample.at(sample.strain + s * t * direction, direction) for s in (1, -1))
    return np.asarray(_components(above.stress - below.stress) / (2 * t))


def _nearest(candidates: list[Floats], wanted: Floats) -> Floats:
    """Return the candidate with the smallest largest error."""
    return min(candidates, key=lambda values: float(np.abs(values - wanted).max()))


def _compare_with_start(sample: _Sample, start: _Sample, direction: Floats) -> None:
    """Raise ValueError unless the tangent of a law that calls itself linear is that at zero."""
    here, there = sample.at(sample.strain, direction), start.at(start.strain, direction)
    sample.demand(
        "linear is True, but the tangent",
        _components(here.change),
        _components(there.change),
        "at zero strain it is",
        float(np.linalg.norm(there.change)),
    )


def _compare_state(sample: _Sample, state: Mapping[str, Floats]) -> float:
    """Return the error of the stress after the new state has become the committed one."""
    none = np.zeros(6)
    before = sample.at(sample.strain, none)
    after = dataclasses.replace(sample, state=state).at(sample.strain, none)
    remedy = "after a commit at the same strain it is"
    scale = max(float(np.linalg.norm(before.stress)), float(np.linalg.norm(before.elastic)))
    for name, value in state.items():
        change = np.abs(value - sample.state[name]).max() + np.abs(value).max()
        sample.demand(f"the state {name}", value, after.state[name], remedy, float(change))
    return sample.demand(
        "the stress", _components(before.stress), _components(after.stress), remedy, scale
    )


def _compare_turned(sample: _Sample, Q: Floats) -> float:
    """Return the error of what a law makes of the elastic strain alone, turned by Q.

    A reflection tells the same as a rotation.
    """
    none = np.zeros(6)
    before = sample.at(sample.strain, none)
    plastic = sample.state.get(PLASTIC, none)
    state = {name: none if name == PLASTIC else v for name, v in sample.state.items()}
    strain = _turned(sample.strain - plastic, Q)
    after = dataclasses.replace(sample, state=state).at(strain, none)
    remedy = "isotropic is True, but of the turned elastic strain it is"
    for name, value in before.state.items():
        new = value
        if name == PLASTIC:
            new = _turned(value - plastic, Q)
        scale = float(max(np.abs(value).max(), np.abs(sample.strain).max()))
        sample.demand(f"the state {name}", np.asarray(new), after.state[name], remedy, scale)
    scale = max(float(np.linalg.norm(before.stress)), float(np.linalg.norm(before.elastic)))
    stress = _turned(_components(before.stress), Q)
    return sample.demand("the stress", stress, _components(after.stress), remedy, scale)


def _turned(components: Floats, Q: Floats) -> Floats:
    """Return the stored components of Q A Q^T."""
    return _components(Q @ tensor_of(components[None])[0] @ Q.T)


def _unit(rng: np.random.Generator) -> Floats:
    """Return stored components of a random symmetric tensor of norm one."""
    components = rng.standard_normal(6)
    return np.asarray(components / np.sqrt(SHEAR @ components**2))


def _components(tensor: Floats) -> Floats:
    """Return the stored components (6,) of a symmetric tensor (3, 3)."""
    return np.array([tensor[i, j] for i, j in INDEX])


def _work(tensor: Floats, direction: Floats) -> float:
    """Return tensor : direction, the direction by its stored components."""
    return float((SHEAR * direction) @ _components(tensor))


def _written(values: Floats) -> str:
    """Return numbers as a short text."""
    numbers = [f"{v:.6g}" for v in np.atleast_1d(values)]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
