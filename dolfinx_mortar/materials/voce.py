# SPDX-License-Identifier: MIT
"""Von Mises plasticity whose isotropic hardening saturates (Voce)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import ufl
from dolfinx_mortar.arrays import EPS
from dolfinx_mortar.materials.elastic import Elastic, shear_modulus
from dolfinx_mortar.materials.protocol import Material
from dolfinx_mortar.materials.ranges import Parameter, Range, check_fields, check_parameters
from dolfinx_mortar.materials.von_mises import (
    ACCUMULATED,
    PLASTIC,
    YIELD_TOLERANCE,
    VonMises,
    shifted_stress,
    tangent_of_return,
)
from ufl.core.expr import Expr

# Below, exp(3 y) is round-off, and three terms of the series of omega in exp(y) are exact (the next
# one is 8/3 exp(4 y)); they keep digits that y - ln w loses.
SERIES_BELOW = float(np.log(np.cbrt(EPS)))


def wright_omega(y: Any) -> Expr:
    """Return w > 0 with w + ln w = y for any y: one step of Halley's method, error below 4e-5 w.

    Equivalently the principal branch of Lambert's function, W(exp(y)).
    """
    z, t, high = ufl.exp(ufl.min_value(y, 0.0)), y - 1, ufl.max_value(y, 1.0)
    w = ufl.conditional(
        ufl.lt(y, 4.0),
        1 + t / 2 + t**2 / 16,  # Taylor's polynomial where w = 1
        high * (1 - 5.4 / (high + 16.0)),  # to 1 %
    )
    w = ufl.conditional(ufl.lt(y, -0.5), z / (1 + z), w)  # to 7 %
    rest, a = y - w - ufl.ln(w), 1 + w
    w = w * (1 + 2 * rest / (2 * a - rest / a))
    return ufl.conditional(ufl.lt(y, SERIES_BELOW), z * (1 - z * (1 - 1.5 * z)), w)


def increment(excess: Any, rest: Any, M: Any, b: Any, log_ratio: Any) -> tuple[Expr, Expr]:
    """Return the root g of M g + rest (1 - exp(-b g)) = excess, and its slope dg / d excess.

    A step of Chebyshev's method, of third order, corrects what omega gives. The residual is then
    round-off of excess and rest, for all numbers whose products are numbers
    (tests/test_hardening.py).

    Args:
        excess: what is to be reached, positive.
        rest: what the exponential can add, positive.
        M: slope of the line, positive.
        b: rate of the exponential, positive.
        log_ratio: ln(b rest / M).
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
class VonMisesVoce(Material):
    r"""Small-strain von Mises plasticity, isotropic hardening with saturation, kinematic hardening.

    As `VonMises`, but the yield radius is

        R(k) = Y + H k + Q (1 - exp(-b k)),      k = int |dep|.

    The increment g of k in a step is the root of |xi| = (2 mu + a) g + R(k_n + g), in closed form
    by Wright's omega function (`increment`). Stress and consistent tangent are those of the radial
    return mapping,

        sigma = C (eps - ep_n) - 2 mu g n,       dg / d|xi| = 1 / (2 mu + a + R'(k_n + g)),

    so that nothing differentiates the solution of the equation; the potential of the step is

        psi = 1/2 (eps - ep_n):C:(eps - ep_n) + a/2 |ep_n|^2
              - |xi| g + (2 mu + a)/2 g^2 + Y g + I(k_n + g),     I' = R - Y,

    whose derivative by g vanishes.

    Source: E. Voce, J. Inst. Metals 74 (1948) 537-562, for the saturation.

    Raises:
        ValueError: naming a parameter that is out of its range.
    """

    E: Parameter  # Young's modulus
    nu: Parameter  # Poisson's ratio
    Y: Parameter  # first yield radius, Frobenius norm: sqrt(2/3) x uniaxial yield stress
    a: Parameter  # kinematic modulus, back stress per plastic strain: 2/3 x uniaxial one
    H: Parameter  # isotropic modulus after saturation: 2/3 x uniaxial one
    Q: Parameter  # growth of the radius by saturation: sqrt(2/3) x that of the yield stress
    b: Parameter  # rate of saturation, per k: sqrt(2/3) x that per equivalent plastic strain

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {PLASTIC: (3, 3), ACCUMULATED: ()}
    linear: ClassVar[bool] = False
    splits: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        **VonMises.ranges,
        "Q": (0.0, math.inf, True),
        "b": (0.0, math.inf, False),
    }
    elastic_stress = staticmethod(Elastic.elastic_stress)
    output = staticmethod(VonMises.output)

    def __post_init__(self) -> None:
        check_fields(self)

    isotropic = VonMises.isotropic

    @classmethod
    def from_uniaxial(
        cls, E: Parameter, nu: Parameter, yield_stress: Parameter, **hardening: Parameter
    ) -> VonMisesVoce:
        """Create the law from a tension test with yield stress s(p), p the plastic strain.

            s(p) = yield_stress + modulus p + saturation (1 - exp(-rate p))

        Args:
            E: Young's modulus.
            nu: Poisson's ratio.
            yield_stress: at p = 0.
            hardening: saturation, rate (per plastic strain), and optionally modulus (0).

        Raises:
            ValueError: for values out of range, naming these arguments.
        """
        known = {"modulus": 0.0} | hardening
        if set(known) != {"saturation", "rate", "modulus"}:
            raise ValueError(
                f"VonMisesVoce.from_uniaxial: got {', '.join(hardening) or 'nothing'}; it takes "
                "saturation=, rate= and optionally modulus=."
            )
        check_parameters(
            "VonMisesVoce.from_uniaxial",
            yield_stress=(yield_stress, 0.0, math.inf, False),
            modulus=(known["modulus"], 0.0, math.inf, True),
            saturation=(known["saturation"], 0.0, math.inf, True),
            rate=(known["rate"], 0.0, math.inf, False),
        )
        root = math.sqrt(2 / 3)
        return cls(
            E, nu, root * yield_stress, 0.0, 2 / 3 * known["modulus"],
            root * known["saturation"], root * known["rate"],
        )  # fmt: skip

    @staticmethod
    def _flow(
        strain: Expr, state: Mapping[str, Expr], p: Any
    ) -> tuple[Expr, Expr, Expr, Expr, Expr]:
        """Return xi, |xi|, the increment g of k, its slope dg / d|xi|, and whether it flows."""
        xi, norm = shifted_stress(strain, state, p)
        k = state[ACCUMULATED]
        rest = p.Q * ufl.exp(-p.b * k)  # what k can still add to the radius
        radius = p.Y + p.H * k + p.Q - rest
        M = 2 * shear_modulus(p) + p.a + p.H
        excess = norm - radius
        yields = ufl.gt(excess, YIELD_TOLERANCE * radius)
        # ln(b rest / M), of which one part is the same at all points of a cell
        g, slope = increment(excess, rest, M, p.b, ufl.ln(p.b * p.Q / M) - p.b * k)
        return xi, norm, ufl.conditional(yields, g, 0.0), slope, yields

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return the incremental potential psi."""
        ep, k = state[PLASTIC], state[ACCUMULATED]
        _, norm, g, _, _ = VonMisesVoce._flow(strain, state, p)
        new = k + g
        stored = p.H / 2 * new**2 + p.Q * (new + (ufl.exp(-p.b * new) - 1) / p.b)
        flow = (2 * shear_modulus(p) + p.a) / 2 * g**2 + (p.Y - norm) * g
        return Elastic.energy(strain - ep, {}, p) + p.a / 2 * ufl.inner(ep, ep) + stored + flow

    @staticmethod
    def stress(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return sigma = C (eps - ep_n) - 2 mu g n."""
        xi, norm, g, _, _ = VonMisesVoce._flow(strain, state, p)
        elastic = Elastic.elastic_stress(strain - state[PLASTIC], p)
        return elastic - 2 * shear_modulus(p) * g / norm * xi

    @staticmethod
    def tangent(strain: Expr, state: Mapping[str, Expr], p: Any, direction: Expr) -> Expr:
        """Return d sigma / d eps : direction."""
        xi, norm, g, slope, yields = VonMisesVoce._flow(strain, state, p)
        grows = ufl.conditional(yields, slope, 0.0)
        return tangent_of_return(xi, norm, g, grows, direction, p)

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return plastic strain and accumulated plastic strain at the end of the step."""
        xi, norm, g, _, _ = VonMisesVoce._flow(strain, state, p)
        return {
            PLASTIC: state[PLASTIC] + g / norm * xi,
            ACCUMULATED: state[ACCUMULATED] + g,
        }
