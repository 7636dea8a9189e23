# SPDX-License-Identifier: MIT
"""Von Mises plasticity with linear kinematic hardening (Prager's rule)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import ufl
from dolfinx_mortar.materials.elastic import Elastic, shear_modulus
from dolfinx_mortar.materials.protocol import check_parameters
from ufl.core.expr import Expr

# A committed plastic point lies on the yield surface up to round-off, which is that of 2 mu eps:
# 1e-16 Y times the strain over the yield strain, so the band is wide enough for 1e5 of those.
# Without it, 12-20 % of such points would count as plastic at the start of the next step.
YIELD_TOLERANCE = 1e-10
# Keeps |xi| differentiable at xi = 0; relative to Y, so independent of the units. At |xi| = Y any
# guard below 1e-8, the root of round-off, changes nothing; its square must not vanish beside zero.
NORM_GUARD = 1e-14


@dataclass(frozen=True)
class VonMises:
    r"""Small-strain von Mises plasticity with linear kinematic hardening.

    With the committed plastic strain ep_n and the trial shifted stress

        xi = 2 mu dev(eps) - (2 mu + a) ep_n          (deviatoric stress minus back stress a ep_n)

    a point yields when |xi| > Y in the Frobenius norm, and then (radial return)

        dgam  = (|xi| - Y)_+ / (2 mu + a),      n = xi / |xi|
        sigma = C (eps - ep_n) - 2 mu dgam n,   ep = ep_n + dgam n,   back stress = a ep.

    Time-discrete normality makes this the gradient of an incremental potential,

        psi = 1/2 (eps - ep_n):C:(eps - ep_n) + a/2 |ep_n|^2 - (|xi| - Y)_+^2 / (2 (2 mu + a)).

    Source: M. Cermak, S. Sysala, J. Valdman, "Efficient and flexible MATLAB implementation of 2D
    and 3D elastoplastic problems", Appl. Math. Comput. 355 (2019) 595-614, for the law; psi is
    the stored energy plus dissipation of the step, minimised over the plastic strain.

    Raises:
        ValueError: if E <= 0, nu is outside (-1, 0.5), Y <= 0, a < 0 or a number is not finite.
    """

    E: float  # Young's modulus
    nu: float  # Poisson's ratio
    Y: float  # yield radius in the Frobenius norm of the deviator: sqrt(2/3) x uniaxial yield
    a: float  # kinematic modulus, back stress per plastic strain: 2/3 x uniaxial plastic modulus

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {"plastic_strain": (3, 3)}
    linear: ClassVar[bool] = False
    elastic_stress = staticmethod(Elastic.elastic_stress)

    def __post_init__(self) -> None:
        """Check the parameters."""
        check_parameters(
            "VonMises",
            E=(self.E, 0.0, math.inf, False),
            nu=(self.nu, -1.0, 0.5, False),
            Y=(self.Y, 0.0, math.inf, False),
            a=(self.a, 0.0, math.inf, True),
        )

    @classmethod
    def from_uniaxial(
        cls, E: float, nu: float, yield_stress: float, plastic_modulus: float
    ) -> VonMises:
        """Create the law from a tension test.

        Args:
            E: Young's modulus.
            nu: Poisson's ratio.
            yield_stress: uniaxial yield stress; Y = sqrt(2/3) yield_stress.
            plastic_modulus: d sigma / d (plastic strain) in tension; a = 2/3 plastic_modulus. A
                test's tangent modulus E_t gives plastic_modulus = E E_t / (E - E_t).

        Raises:
            ValueError: for the same ranges, naming these arguments.
        """
        check_parameters(
            "VonMises.from_uniaxial",
            yield_stress=(yield_stress, 0.0, math.inf, False),
            plastic_modulus=(plastic_modulus, 0.0, math.inf, True),
        )
        return cls(E, nu, math.sqrt(2 / 3) * yield_stress, 2 / 3 * plastic_modulus)

    @staticmethod
    def _trial(strain: Expr, state: Mapping[str, Expr], p: Any) -> tuple[Expr, Expr, Expr]:
        """Return xi, |xi| and (|xi| - Y)_+ with the dead band at zero."""
        mu = shear_modulus(p)
        xi = 2 * mu * ufl.dev(strain) - (2 * mu + p.a) * state["plastic_strain"]
        norm = ufl.sqrt(ufl.inner(xi, xi) + (NORM_GUARD * p.Y) ** 2)
        excess = norm - p.Y
        yields = ufl.gt(excess, YIELD_TOLERANCE * p.Y)
        return xi, norm, ufl.conditional(yields, excess, 0.0)

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return the incremental potential psi."""
        ep = state["plastic_strain"]
        _, _, excess = VonMises._trial(strain, state, p)
        hardening = p.a / 2 * ufl.inner(ep, ep)
        relaxation = excess**2 / (2 * (2 * shear_modulus(p) + p.a))
        return Elastic.energy(strain - ep, {}, p) + hardening - relaxation

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return the plastic strain at the end of the step."""
        xi, norm, excess = VonMises._trial(strain, state, p)
        increment = excess / ((2 * shear_modulus(p) + p.a) * norm) * xi
        return {"plastic_strain": state["plastic_strain"] + increment}

    @staticmethod
    def output(state: Mapping[str, np.ndarray], p: SimpleNamespace) -> dict[str, np.ndarray]:
        """Return the back stress a ep (q, components)."""
        return {"back_stress": p.a[:, None] * state["plastic_strain"]}
