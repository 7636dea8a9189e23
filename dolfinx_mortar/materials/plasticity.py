# SPDX-License-Identifier: MIT
"""Plasticity of von Mises (hardening by Prager, linear, by Voce) and of Drucker and Prager."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import ufl
from dolfinx_mortar.common.arguments import check, one_of
from dolfinx_mortar.common.arrays import EPS, TINY
from dolfinx_mortar.materials.elastic import Elastic, bulk_modulus, lame_modulus, shear_modulus
from dolfinx_mortar.materials.protocol import (
    NOT_NEGATIVE,
    PLASTIC,
    POSITIVE,
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
        "Y": POSITIVE,
        "a": NOT_NEGATIVE,
        "H": NOT_NEGATIVE,
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
            yield_stress=(yield_stress, *POSITIVE),
            plastic_modulus=(plastic_modulus, *NOT_NEGATIVE),
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


def increment(excess: Any, rest: Any, M: Any, b: Any, log_ratio: Any) -> tuple[Expr, Expr]:
    """Root g of M g + rest (1 - exp(-b g)) = excess, and its slope dg / d excess; all positive.

    `log_ratio` is ln(b rest / M). Newton's method for v = log_ratio - b g, v + exp(v) = y, from
    above; the last step is one for g.
    """
    level = b * (excess - rest) / M
    y = log_ratio - level
    v = ufl.min_value(y, ufl.ln(ufl.max_value(y, 1.0)))  # 0.57 off at most
    for _ in range(4):  # to round-off
        v -= (v + ufl.exp(v) - y) / (1 + ufl.exp(v))
    w = ufl.exp(v)
    return (level + w * (1 + log_ratio - v)) / (b * (1 + w)), 1 / (M * (1 + w))


@dataclass(frozen=True)
class VonMisesVoce(RadialReturn):
    """Small-strain von Mises plasticity with saturating isotropic and kinematic hardening.

    As `VonMises`, but the yield radius is

        R(k) = Y + H k + Q (1 - exp(-b k)),      k = int |dep|.

    The increment g of k in a step is the root of |xi| = (2 mu + a) g + R(k_n + g), by Newton's
    method to round-off. Stress and consistent tangent are given by

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
        "Q": NOT_NEGATIVE,
        "b": POSITIVE,
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
            yield_stress=(yield_stress, *POSITIVE),
            modulus=(modulus, *NOT_NEGATIVE),
            saturation=(saturation, *NOT_NEGATIVE),
            rate=(rate, *POSITIVE),
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
        log_ratio = ufl.ln(ufl.max_value(p.b * p.Q / M, TINY)) - p.b * k
        return increment(excess, p.Q * ufl.exp(-p.b * k), M, p.b, log_ratio)

    @staticmethod
    def _hardening(k: Expr, H: Expr, p: Any) -> Expr:
        return H / 2 * k**2 + p.Q * (k + (ufl.exp(-p.b * k) - 1) / p.b)


@dataclass(frozen=True)
class DruckerPrager(CheckedLaw):
    """Small-strain associated perfect plasticity in the cone of Drucker and Prager.

        |dev sigma| + beta p <= Y,      p = tr(sigma) / 3 (tension positive), apex at p = Y / beta

    With e = eps - ep_n, trial stress s + p I = C e, yield function f = |s| + beta p - Y and bulk
    modulus K, the return mapping is the closest-point projection in the elastic energy:

        cone  g = f / (2 mu + K beta^2),   sigma = (p - K beta g) I + (1 - 2 mu g / |s|) s
        apex  sigma = Y / beta I,          where 2 mu g > |s|
        ep = ep_n + g (s / |s| + beta/3 I)  or  eps - C^-1 sigma.

    The stress is the gradient of the incremental potential

        psi = 1/2 e:C:e - f^2 / (2 (2 mu + K beta^2))      on the cone
        psi = Y / beta tr e - (Y / beta)^2 / (2 K)          at the apex.

    Plastic flow dilates: tr dep = beta |dev dep|. Without hardening there are limit loads; a body
    with all points at the apex has no stiffness.

    Source: D. C. Drucker, W. Prager, Q. Appl. Math. 10 (1952) 157-165; E. A. de Souza Neto, D.
    Peric, D. R. J. Owen, Computational Methods for Plasticity (2008), section 8.3.

    Raises:
        ValueError: naming a parameter that is out of its range.
    """

    E: Parameter  # Young's modulus
    nu: Parameter  # Poisson's ratio
    Y: Parameter  # radius of the cone without pressure, Frobenius norm
    beta: Parameter  # growth of the radius per pressure

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {"plastic_strain": (3, 3)}
    isotropic: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        **Elastic.ranges,
        "Y": POSITIVE,
        "beta": POSITIVE,
    }
    elastic_stress = staticmethod(Elastic.elastic_stress)

    @classmethod
    def from_mohr_coulomb(
        cls, E: Parameter, nu: Parameter, cohesion: float, friction_angle: float, match: str
    ) -> DruckerPrager:
        """Create the law from cohesion and angle of friction.

        `match` is where the cone meets the pyramid of Mohr and Coulomb:

        * "compression": triaxial compression, the outer edges (the largest cone);
        * "extension": triaxial extension, the inner edges;
        * "plane strain": collapse in plane strain with associated flow (the inscribed cone).

        Args:
            cohesion: shear stress at failure without normal stress.
            friction_angle: in degrees, between 0 and 90.
            match: see above.

        Raises:
            ValueError: for other values, naming the argument.
        """
        check_parameters(
            "DruckerPrager.from_mohr_coulomb",
            cohesion=(cohesion, *POSITIVE),
            friction_angle=(friction_angle, 0.0, 90.0, False),
        )
        sine, cosine = (f(math.radians(friction_angle)) for f in (math.sin, math.cos))
        scales = {
            "compression": 6 / (math.sqrt(3) * (3 - sine)),
            "extension": 6 / (math.sqrt(3) * (3 + sine)),
            "plane strain": 3 / math.sqrt(9 * cosine**2 + 12 * sine**2),
        }
        check("DruckerPrager.from_mohr_coulomb: match", match, one_of(*scales))
        scale = math.sqrt(2) * scales[match]
        return cls(E, nu, scale * cosine * cohesion, scale * sine)

    @staticmethod
    def _return(strain: Expr, state: Mapping[str, Expr], p: Any) -> tuple[Expr, ...]:
        """Return s, |s|, p, |dev dep| on the cone, and whether to return, and to the apex."""
        elastic = strain - state["plastic_strain"]
        mu, K = shear_modulus(p), bulk_modulus(p)
        s, mean = 2 * mu * ufl.dev(elastic), K * ufl.tr(elastic)
        norm = ufl.sqrt(ufl.inner(s, s) + (EPS * p.Y) ** 2)
        excess = norm + p.beta * mean - p.Y
        g = excess / (2 * mu + K * p.beta**2)
        return s, norm, mean, g, ufl.gt(excess, YIELD_TOLERANCE * p.Y), ufl.gt(2 * mu * g, norm)

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi."""
        *_, g, yields, to_apex = DruckerPrager._return(strain, state, p)
        elastic, K = strain - state["plastic_strain"], bulk_modulus(p)
        stored = Elastic.energy(elastic, {}, p)
        cone = stored - g**2 * (2 * shear_modulus(p) + K * p.beta**2) / 2
        apex = p.Y / p.beta * (ufl.tr(elastic) - p.Y / (2 * p.beta * K))
        return ufl.conditional(yields, ufl.conditional(to_apex, apex, cone), stored)

    @staticmethod
    def stress(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return sigma."""
        s, norm, mean, g, yields, to_apex = DruckerPrager._return(strain, state, p)
        g, to_apex = ufl.conditional(yields, g, 0.0), ufl.And(yields, to_apex)
        shrunk = ufl.conditional(to_apex, 0.0, 1 - 2 * shear_modulus(p) * g / norm)
        mean = ufl.conditional(to_apex, p.Y / p.beta, mean - bulk_modulus(p) * p.beta * g)
        return mean * ufl.Identity(3) + shrunk * s

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return ep = eps - C^-1 sigma."""
        sigma, yields = (
            DruckerPrager.stress(strain, state, p),
            DruckerPrager._return(strain, state, p)[4],
        )
        elastic = ufl.dev(sigma) / (2 * shear_modulus(p))
        elastic += ufl.tr(sigma) / (9 * bulk_modulus(p)) * ufl.Identity(3)
        old = state["plastic_strain"]
        return {"plastic_strain": ufl.conditional(yields, strain - elastic, old)}
