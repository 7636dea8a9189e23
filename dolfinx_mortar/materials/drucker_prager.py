# SPDX-License-Identifier: MIT
"""Pressure-dependent plasticity by Drucker and Prager."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import ufl
from dolfinx_mortar.arrays import EPS
from dolfinx_mortar.materials.elastic import Elastic, bulk_modulus, shear_modulus
from dolfinx_mortar.materials.protocol import (
    Material,
    Parameter,
    Range,
    check_fields,
    check_parameters,
)
from dolfinx_mortar.materials.von_mises import YIELD_TOLERANCE
from ufl.core.expr import Expr


class _Return(NamedTuple):
    s: Expr
    norm: Expr
    p: Expr
    g: Expr  # |dev dep| on the cone
    yields: Expr
    apex: Expr  # condition: return to the apex


@dataclass(frozen=True)
class DruckerPrager(Material):
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
    linear: ClassVar[bool] = False
    ranges: ClassVar[Mapping[str, Range]] = {
        **Elastic.ranges,
        "Y": (0.0, math.inf, False),
        "beta": (0.0, math.inf, False),
    }
    elastic_stress = staticmethod(Elastic.elastic_stress)

    def __post_init__(self) -> None:
        check_fields(self)

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
            cohesion=(cohesion, 0.0, math.inf, False),
            friction_angle=(friction_angle, 0.0, 90.0, False),
        )
        sine, cosine = (f(math.radians(friction_angle)) for f in (math.sin, math.cos))
        scales = {
            "compression": 6 / (math.sqrt(3) * (3 - sine)),
            "extension": 6 / (math.sqrt(3) * (3 + sine)),
            "plane strain": 3 / math.sqrt(9 * cosine**2 + 12 * sine**2),
        }
        if match not in scales:
            raise ValueError(
                f"DruckerPrager.from_mohr_coulomb: match is {match!r}; choose one of "
                f"{', '.join(map(repr, scales))}."
            )
        scale = math.sqrt(2) * scales[match]
        return cls(E, nu, scale * cosine * cohesion, scale * sine)

    @staticmethod
    def _return(strain: Expr, state: Mapping[str, Expr], p: Any) -> _Return:
        elastic = strain - state["plastic_strain"]
        mu, K = shear_modulus(p), bulk_modulus(p)
        s, mean = 2 * mu * ufl.dev(elastic), K * ufl.tr(elastic)
        norm = ufl.sqrt(ufl.inner(s, s) + (EPS * p.Y) ** 2)
        excess = norm + p.beta * mean - p.Y
        g = excess / (2 * mu + K * p.beta**2)
        yields = ufl.gt(excess, YIELD_TOLERANCE * p.Y)
        return _Return(s, norm, mean, g, yields, ufl.gt(2 * mu * g, norm))

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi."""
        r, elastic = DruckerPrager._return(strain, state, p), strain - state["plastic_strain"]
        stored = Elastic.energy(elastic, {}, p)
        cone = stored - r.g**2 * (2 * shear_modulus(p) + bulk_modulus(p) * p.beta**2) / 2
        apex = p.Y / p.beta * (ufl.tr(elastic) - p.Y / (2 * p.beta * bulk_modulus(p)))
        return ufl.conditional(r.yields, ufl.conditional(r.apex, apex, cone), stored)

    @staticmethod
    def stress(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return sigma."""
        r = DruckerPrager._return(strain, state, p)
        g = ufl.conditional(r.yields, r.g, 0.0)
        shrunk = 1 - 2 * shear_modulus(p) * g / r.norm
        apex = ufl.And(r.yields, r.apex)
        mean = ufl.conditional(apex, p.Y / p.beta, r.p - bulk_modulus(p) * p.beta * g)
        return mean * ufl.Identity(3) + ufl.conditional(apex, 0.0, shrunk) * r.s

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return ep."""
        r, ep = DruckerPrager._return(strain, state, p), state["plastic_strain"]
        cone = r.g * (r.s / r.norm + p.beta / 3 * ufl.Identity(3))
        apex = strain - ep - p.Y / (3 * p.beta * bulk_modulus(p)) * ufl.Identity(3)
        rest = ufl.as_tensor([[0.0] * 3] * 3)
        grown = ufl.conditional(r.yields, ufl.conditional(r.apex, apex, cone), rest)
        return {"plastic_strain": ep + grown}
