# SPDX-License-Identifier: MIT
"""Isotropic linear elasticity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import ufl
from dolfinx_mortar.materials.protocol import check_parameters
from ufl.core.expr import Expr


def shear_modulus(p: Any) -> Any:
    """Return mu = E / (2 (1 + nu)), of numbers, arrays or UFL."""
    return p.E / (2 * (1 + p.nu))


def lame_modulus(p: Any) -> Any:
    """Return lambda = E nu / ((1 + nu)(1 - 2 nu)), of numbers, arrays or UFL."""
    return p.E * p.nu / ((1 + p.nu) * (1 - 2 * p.nu))


@dataclass(frozen=True)
class Elastic:
    """Hooke's law, sigma = lambda tr(eps) I + 2 mu eps.

    Raises:
        ValueError: if E <= 0, nu is outside (-1, 0.5) or a number is not finite.
    """

    E: float  # Young's modulus
    nu: float  # Poisson's ratio

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    linear: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the parameters."""
        check_parameters(
            "Elastic", E=(self.E, 0.0, math.inf, False), nu=(self.nu, -1.0, 0.5, False)
        )

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain."""
        return lame_modulus(p) * ufl.tr(strain) * ufl.Identity(3) + 2 * shear_modulus(p) * strain

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi = lambda/2 tr(eps)^2 + mu eps:eps."""
        return lame_modulus(p) / 2 * ufl.tr(strain) ** 2 + shear_modulus(p) * ufl.inner(
            strain, strain
        )

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return nothing: elasticity has no memory."""
        return {}

    @staticmethod
    def output(state: Mapping[str, np.ndarray], p: SimpleNamespace) -> dict[str, np.ndarray]:
        """Return nothing beyond the stress."""
        return {}
