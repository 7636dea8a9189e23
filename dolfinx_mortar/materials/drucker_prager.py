# SPDX-License-Identifier: MIT
"""Pressure-dependent plasticity by Drucker and Prager."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx_mortar.common.arguments import check, one_of
from dolfinx_mortar.common.arrays import EPS
from dolfinx_mortar.materials.elastic import Elastic, bulk_modulus, shear_modulus
from dolfinx_mortar.materials.protocol import CheckedLaw, Parameter, Range, check_parameters
from dolfinx_mortar.materials.von_mises import YIELD_TOLERANCE
from ufl.core.expr import Expr


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
        "Y": (0.0, math.inf, False),
        "beta": (0.0, math.inf, False),
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
            cohesion=(cohesion, 0.0, math.inf, False),
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
