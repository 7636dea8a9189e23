# SPDX-License-Identifier: MIT
"""Von Mises plasticity: kinematic (Prager) and isotropic hardening, linear or saturating (Voce)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import ufl
from dolfinx_mortar.common.arrays import EPS
from dolfinx_mortar.materials.elastic import Elastic, lame_modulus, shear_modulus
from dolfinx_mortar.materials.protocol import (
    PLASTIC,
    CheckedLaw,
    Parameter,
    Range,
    check_parameters,
)
from ufl.core.expr import Expr

# Dead band of yielding: round-off up to 1e5 yield strains.
YIELD_TOLERANCE = 1e-10
ACCUMULATED = "accumulated_plastic_strain"


def _memory(state: Mapping[str, Expr], p: Any) -> tuple[Any, Any]:
    """Return k and H, zero without k."""
    return (state[ACCUMULATED], p.H) if ACCUMULATED in state else (0.0, 0.0)


@dataclass(frozen=True)
class RadialReturn(CheckedLaw):
    """Von Mises plasticity with the radius R(k) of a subclass; I' = R - Y."""

    E: Parameter  # Young's modulus
    nu: Parameter  # Poisson's ratio
    Y: Parameter  # first yield radius, Frobenius norm: sqrt(2/3) x uniaxial yield stress
    a: Parameter  # kinematic modulus, back stress per plastic strain: 2/3 x uniaxial one

    _radius: ClassVar[Callable[..., Any]]  # k, H, p -> R
    _increment: ClassVar[Callable[..., Any]]  # |xi| - R(k), k, H, p -> g > 0 and dg / d|xi|
    _hardening: ClassVar[Callable[..., Any]]  # k, H, p -> I
    splits: ClassVar[bool] = True
    elastic_stress = staticmethod(Elastic.elastic_stress)

    @property
    def isotropic(self) -> bool:
        """Whether there is no kinematic hardening."""
        return isinstance(self.a, Real) and self.a == 0

    @classmethod
    def _flow(
        cls, strain: Expr, state: Mapping[str, Expr], p: Any
    ) -> tuple[Expr, Expr, Expr, Expr]:
        """Return xi, |xi| (differentiable also at 0), the increment g of k, and dg / d|xi|."""
        mu, memory = shear_modulus(p), _memory(state, p)
        xi = 2 * mu * ufl.dev(strain) - (2 * mu + p.a) * state[PLASTIC]
        norm, radius = ufl.sqrt(ufl.inner(xi, xi) + (EPS * p.Y) ** 2), cls._radius(*memory, p)
        yields = ufl.gt(norm - radius, YIELD_TOLERANCE * radius)
        found = cls._increment(norm - radius, *memory, p)
        return xi, norm, *(ufl.conditional(yields, value, 0.0) for value in found)

    @classmethod
    def energy(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi."""
        ep, (_, norm, g, _) = state[PLASTIC], cls._flow(strain, state, p)
        flow = (2 * shear_modulus(p) + p.a) / 2 * g**2 + (p.Y - norm) * g
        k, H = _memory(state, p)
        stored = p.a / 2 * ufl.inner(ep, ep) + cls._hardening(k + g, H, p)
        return Elastic.energy(strain - ep, {}, p) + stored + flow

    @classmethod
    def stress(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return sigma = C (eps - ep_n) - 2 mu g n, n = xi / |xi|."""
        xi, norm, g, _ = cls._flow(strain, state, p)
        elastic = Elastic.elastic_stress(strain - state[PLASTIC], p)
        return elastic - 2 * shear_modulus(p) * g / norm * xi

    @classmethod
    def tangent(cls, strain: Expr, state: Mapping[str, Expr], p: Any, direction: Expr) -> Expr:
        """Return d sigma / d eps : direction.

        With t = g / |xi| and s = dg / d|xi|, both 0 in elastic states,

            C : direction - 4 mu^2 (t dev(direction) + (s - t) (n : direction) n).
        """
        xi, norm, g, slope = cls._flow(strain, state, p)
        xi, mu, turn = ufl.dev(xi), shear_modulus(p), g / norm
        trace = (lame_modulus(p) + 4 / 3 * mu**2 * turn) * ufl.tr(direction) * ufl.Identity(3)
        along = 4 * mu**2 * (slope - turn) / norm**2 * ufl.inner(xi, direction) * xi
        return trace + 2 * mu * (1 - 2 * mu * turn) * direction - along

    @classmethod
    def updated_state(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Plastic strain and, with isotropic hardening, k at the end of the step."""
        xi, norm, g, _ = cls._flow(strain, state, p)
        new = {PLASTIC: state[PLASTIC] + g / norm * xi}
        return new | ({ACCUMULATED: state[ACCUMULATED] + g} if ACCUMULATED in state else {})

    @staticmethod
    def output(state: Mapping[str, np.ndarray], p: SimpleNamespace) -> dict[str, np.ndarray]:
        """Back stress a ep (q, components)."""
        return {"back_stress": p.a[:, None] * state["plastic_strain"]}


@dataclass(frozen=True)
class VonMises(RadialReturn):
    """Small-strain von Mises plasticity with linear kinematic and isotropic hardening.

    With the committed plastic strain ep_n and the trial shifted stress

        xi = 2 mu dev(eps) - (2 mu + a) ep_n          (deviatoric stress minus back stress a ep_n)

    and the accumulated plastic strain k_n = int |dep|, a point yields when |xi| > Y + H k_n in the
    Frobenius norm, and then (radial return)

        dgam  = (|xi| - Y - H k_n)_+ / (2 mu + a + H),   n = xi / |xi|,   k = k_n + dgam
        sigma = C (eps - ep_n) - 2 mu dgam n,   ep = ep_n + dgam n,   back stress = a ep.

    The incremental potential is

        psi = 1/2 (eps - ep_n):C:(eps - ep_n) + a/2 |ep_n|^2 + H/2 k_n^2
              - (|xi| - Y - H k_n)_+^2 / (2 (2 mu + a + H)).

    In tension, with plastic strain p = sqrt(2/3) k, the stress at first loading is sqrt(3/2) Y +
    3/2 (a + H) p. Only with H is k an internal variable, ``accumulated_plastic_strain``.

    Source: M. Cermak, S. Sysala, J. Valdman, Appl. Math. Comput. 355 (2019) 595-614.

    Raises:
        ValueError: naming a parameter that is out of its range.
    """

    H: Parameter = 0.0  # isotropic modulus, yield radius per k: 2/3 x uniaxial one

    ranges: ClassVar[Mapping[str, Range]] = {
        **Elastic.ranges,
        "Y": (0.0, math.inf, False),
        "a": (0.0, math.inf, True),
        "H": (0.0, math.inf, True),
    }

    @property
    def state(self) -> Mapping[str, tuple[int, ...]]:  # type: ignore[override]
        """Plastic strain, k with isotropic hardening."""
        kinematic = isinstance(self.H, Real) and self.H == 0
        return {PLASTIC: (3, 3)} if kinematic else {PLASTIC: (3, 3), ACCUMULATED: ()}

    @classmethod
    def from_uniaxial(
        cls,
        E: Parameter,
        nu: Parameter,
        yield_stress: Parameter,
        plastic_modulus: Parameter,
        *,
        isotropic: float = 0.0,
    ) -> VonMises:
        """Create the law from a tension test.

        Args:
            yield_stress: uniaxial; Y = sqrt(2/3) yield_stress.
            plastic_modulus: d sigma / d (plastic strain) in tension; a + H = 2/3 plastic_modulus. A
                tangent modulus E_t gives E E_t / (E - E_t).
            isotropic: share of isotropic hardening, from 0 to 1; the rest is kinematic. On reversal
                the bar yields 2 (yield_stress + isotropic (stress - yield_stress)) lower.

        Raises:
            ValueError: naming an argument that is out of its range.
        """
        check_parameters(
            "VonMises.from_uniaxial",
            yield_stress=(yield_stress, 0.0, math.inf, False),
            plastic_modulus=(plastic_modulus, 0.0, math.inf, True),
            isotropic=(isotropic, 0.0, math.nextafter(1.0, 2.0), True),
        )
        modulus = 2 / 3 * plastic_modulus
        # 0 * modulus is not a number in UFL: k would be unused
        a, H = ((1 - isotropic) * modulus, isotropic * modulus) if isotropic else (modulus, 0.0)
        return cls(E, nu, math.sqrt(2 / 3) * yield_stress, a, H)

    @staticmethod
    def _radius(k: Expr, H: Expr, p: Any) -> Expr:
        return p.Y + H * k

    @staticmethod
    def _increment(excess: Expr, k: Expr, H: Expr, p: Any) -> tuple[Expr, Expr]:
        slope = 1 / (2 * shear_modulus(p) + p.a + H)
        return slope * excess, slope

    @staticmethod
    def _hardening(k: Expr, H: Expr, p: Any) -> Expr:
        return H / 2 * k**2


# Below it exp(3 y) is round-off, and three terms of the series of omega are exact.
SERIES_BELOW = float(np.log(np.cbrt(EPS)))


def wright_omega(y: Any) -> Expr:
    """Return w = W(exp(y)), w + ln w = y: one step of Halley's method, error below 4e-5 w."""
    z, t, high = ufl.exp(ufl.min_value(y, 0.0)), y - 1, ufl.max_value(y, 1.0)
    w = ufl.conditional(
        ufl.lt(y, 4.0),
        1 + t / 2 + t**2 / 16,  # Taylor polynomial at w = 1
        high * (1 - 5.4 / (high + 16.0)),  # to 1 %
    )
    w = ufl.conditional(ufl.lt(y, -0.5), z / (1 + z), w)  # to 7 %
    rest, a = y - w - ufl.ln(w), 1 + w
    w = w * (1 + 2 * rest / (2 * a - rest / a))
    return ufl.conditional(ufl.lt(y, SERIES_BELOW), z * (1 - z * (1 - 1.5 * z)), w)


def increment(excess: Any, rest: Any, M: Any, b: Any, log_ratio: Any) -> tuple[Expr, Expr]:
    """Root g of M g + rest (1 - exp(-b g)) = excess, and its slope dg / d excess; all positive.

    `log_ratio` is ln(b rest / M). A step of Chebyshev's method corrects omega to round-off.
    """
    level = (excess - rest) / M
    y = log_ratio - b * level
    omega = wright_omega(y)  # b rest exp(-b g) / M
    near = ufl.conditional(ufl.lt(y, 1.0), level + omega / b, (log_ratio - ufl.ln(omega)) / b)
    fading = rest * ufl.exp(-b * near)
    slope = 1 / (M + b * fading)
    newton = slope * (excess - rest + fading * (1 + b * near))
    change = b * (newton - near)
    g = newton + slope * fading * change**2 / 2
    return g, 1 / (M + b * fading * (1 - change * (1 - change / 2)))


@dataclass(frozen=True)
class VonMisesVoce(RadialReturn):
    """Small-strain von Mises plasticity with saturating isotropic and kinematic hardening.

    As `VonMises`, but the yield radius is

        R(k) = Y + H k + Q (1 - exp(-b k)),      k = int |dep|.

    The increment g of k in a step is the root of |xi| = (2 mu + a) g + R(k_n + g), in closed form
    by Wright's omega function. Stress and consistent tangent are given by

        sigma = C (eps - ep_n) - 2 mu g n,       dg / d|xi| = 1 / (2 mu + a + R'(k_n + g));

    the incremental potential is

        psi = 1/2 (eps - ep_n):C:(eps - ep_n) + a/2 |ep_n|^2
              - |xi| g + (2 mu + a)/2 g^2 + Y g + I(k_n + g),     I' = R - Y.

    Source: E. Voce, J. Inst. Metals 74 (1948) 537-562.

    Raises:
        ValueError: naming a parameter that is out of its range.
    """

    H: Parameter  # isotropic modulus after saturation, as in `VonMises`
    Q: Parameter  # growth of the radius by saturation: sqrt(2/3) x that of the yield stress
    b: Parameter  # rate of saturation, per k: sqrt(2/3) x that per equivalent plastic strain

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {PLASTIC: (3, 3), ACCUMULATED: ()}
    ranges: ClassVar[Mapping[str, Range]] = {
        **VonMises.ranges,
        "Q": (0.0, math.inf, True),
        "b": (0.0, math.inf, False),
    }

    @classmethod
    def from_uniaxial(
        cls,
        E: Parameter,
        nu: Parameter,
        yield_stress: Parameter,
        *,
        saturation: Parameter,
        rate: Parameter,
        modulus: Parameter = 0.0,
    ) -> VonMisesVoce:
        """Create the law from a tension test with yield stress s(p), p the plastic strain.

            s(p) = yield_stress + modulus p + saturation (1 - exp(-rate p))

        Args:
            yield_stress: at p = 0.
            saturation: growth of the yield stress.
            rate: of saturation, per plastic strain.
            modulus: after saturation.

        Raises:
            ValueError: naming an argument that is out of its range.
        """
        check_parameters(
            "VonMisesVoce.from_uniaxial",
            yield_stress=(yield_stress, 0.0, math.inf, False),
            modulus=(modulus, 0.0, math.inf, True),
            saturation=(saturation, 0.0, math.inf, True),
            rate=(rate, 0.0, math.inf, False),
        )
        root = math.sqrt(2 / 3)
        return cls(
            E, nu, root * yield_stress, 0.0, 2 / 3 * modulus,
            root * saturation, root * rate,
        )  # fmt: skip

    @staticmethod
    def _radius(k: Expr, H: Expr, p: Any) -> Expr:
        return p.Y + H * k + p.Q - p.Q * ufl.exp(-p.b * k)

    @staticmethod
    def _increment(excess: Expr, k: Expr, H: Expr, p: Any) -> tuple[Expr, Expr]:
        M = 2 * shear_modulus(p) + p.a + H
        # split: one part is the same at all points of a cell
        log_ratio = ufl.ln(p.b * p.Q / M) - p.b * k
        return increment(excess, p.Q * ufl.exp(-p.b * k), M, p.b, log_ratio)

    @staticmethod
    def _hardening(k: Expr, H: Expr, p: Any) -> Expr:
        return H / 2 * k**2 + p.Q * (k + (ufl.exp(-p.b * k) - 1) / p.b)
