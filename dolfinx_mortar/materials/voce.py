# SPDX-License-Identifier: MIT
"""Von Mises plasticity whose isotropic hardening saturates (Voce)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx_mortar.materials.elastic import Elastic, shear_modulus
from dolfinx_mortar.materials.omega import wright_omega
from dolfinx_mortar.materials.parameters import Parameter, Range, check_fields, check_parameters
from dolfinx_mortar.materials.protocol import Material
from dolfinx_mortar.materials.von_mises import (
    YIELD_TOLERANCE,
    MixedVonMises,
    VonMises,
    shifted_stress,
)
from ufl.core.expr import Expr


@dataclass(frozen=True)
class VonMisesVoce(Material):
    r"""Small-strain von Mises plasticity, isotropic hardening with saturation, kinematic hardening.

    As `VonMises`, but the yield radius is

        R(k) = Y + H k + Q (1 - exp(-b k)),      k = int |dep|.

    The increment g of k in a step is the root of |xi| = (2 mu + a) g + R(k_n + g), in closed form
    by Wright's omega function. Stress and tangent are those of the radial return,

        sigma = C (eps - ep_n) - 2 mu g n,       dg / d|xi| = 1 / (2 mu + a + R'(k_n + g)),

    so that nothing differentiates the solution of the equation; the potential of the step is

        psi = 1/2 (eps - ep_n):C:(eps - ep_n) + a/2 |ep_n|^2
              - |xi| g + (2 mu + a)/2 g^2 + Y g + I(k_n + g),     I' = R - Y,

    whose derivative by g vanishes.

    Raises:
        ValueError: if E <= 0, nu is outside (-1, 0.5), Y <= 0, b <= 0, one of a, H and Q is
            negative, or a number is not finite.
    """

    E: Parameter  # Young's modulus
    nu: Parameter  # Poisson's ratio
    Y: Parameter  # first yield radius, Frobenius norm: sqrt(2/3) x uniaxial yield stress
    a: Parameter  # kinematic modulus, back stress per plastic strain: 2/3 x uniaxial one
    H: Parameter  # isotropic modulus after saturation: 2/3 x uniaxial one
    Q: Parameter  # growth of the radius by saturation: sqrt(2/3) x that of the yield stress
    b: Parameter  # rate of saturation, per k: sqrt(2/3) x that per equivalent plastic strain

    state: ClassVar[Mapping[str, tuple[int, ...]]] = MixedVonMises.state
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
        """Check the parameters."""
        check_fields(self)

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
        k = state["accumulated_plastic_strain"]
        rest = p.Q * ufl.exp(-p.b * k)  # what k can still add to the radius
        radius = p.Y + p.H * k + p.Q - rest
        M = 2 * shear_modulus(p) + p.a + p.H
        excess = norm - radius
        yields = ufl.gt(excess, YIELD_TOLERANCE * radius)
        # M g + rest (1 - exp(-b g)) = excess
        level = (excess - rest) / M
        # ln(b rest / M), of which one part is the same at all points of a cell
        start = ufl.ln(p.b * p.Q / M) - p.b * k
        near = level + wright_omega(start - p.b * level, steps=1) / p.b
        # a step of Chebyshev's method, of third order, takes away that error and cancellation
        fading = rest * ufl.exp(-p.b * near)
        slope = 1 / (M + p.b * fading)
        newton = slope * (excess - rest + fading * (1 + p.b * near))
        change = p.b * (newton - near)
        g = newton + slope * fading * change**2 / 2
        slope = 1 / (M + p.b * fading * (1 - change * (1 - change / 2)))
        return xi, norm, ufl.conditional(yields, g, 0.0), slope, yields

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return the incremental potential psi."""
        ep, k = state["plastic_strain"], state["accumulated_plastic_strain"]
        _, norm, g, _, _ = VonMisesVoce._flow(strain, state, p)
        new = k + g
        stored = p.H / 2 * new**2 + p.Q * (new + (ufl.exp(-p.b * new) - 1) / p.b)
        flow = (2 * shear_modulus(p) + p.a) / 2 * g**2 + (p.Y - norm) * g
        return Elastic.energy(strain - ep, {}, p) + p.a / 2 * ufl.inner(ep, ep) + stored + flow

    @staticmethod
    def stress(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return sigma = C (eps - ep_n) - 2 mu g n."""
        xi, norm, g, _, _ = VonMisesVoce._flow(strain, state, p)
        elastic = Elastic.elastic_stress(strain - state["plastic_strain"], p)
        return elastic - 2 * shear_modulus(p) * g / norm * xi

    @staticmethod
    def tangent(strain: Expr, state: Mapping[str, Expr], p: Any, direction: Expr) -> Expr:
        """Return d sigma / d eps : direction."""
        xi, norm, g, slope, yields = VonMisesVoce._flow(strain, state, p)
        mu, n = shear_modulus(p), xi / norm
        change = 2 * mu * ufl.dev(direction)  # of xi
        along = ufl.inner(n, change)
        turn = g / norm * (change - along * n) + slope * along * n
        zero = ufl.as_tensor([[0.0] * 3] * 3)
        flow = ufl.conditional(yields, turn, zero)
        return Elastic.elastic_stress(direction, p) - 2 * mu * flow

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return plastic strain and accumulated plastic strain at the end of the step."""
        xi, norm, g, _, _ = VonMisesVoce._flow(strain, state, p)
        return {
            "plastic_strain": state["plastic_strain"] + g / norm * xi,
            "accumulated_plastic_strain": state["accumulated_plastic_strain"] + g,
        }
