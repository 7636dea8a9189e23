# SPDX-License-Identifier: MIT
"""Isotropic linear elasticity."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx_mortar.materials.protocol import Material
from dolfinx_mortar.materials.ranges import Parameter, Range, check_fields
from ufl.core.expr import Expr


def shear_modulus(p: Any) -> Any:
    """Return mu = E / (2 (1 + nu)), of numbers, arrays or UFL."""
    return p.E / (2 * (1 + p.nu))


def lame_modulus(p: Any) -> Any:
    """Return lambda = E nu / ((1 + nu)(1 - 2 nu)), of numbers, arrays or UFL."""
    return p.E * p.nu / ((1 + p.nu) * (1 - 2 * p.nu))


def bulk_modulus(p: Any) -> Any:
    """Return K = E / (3 (1 - 2 nu)), of numbers, arrays or UFL."""
    return p.E / (3 * (1 - 2 * p.nu))


@dataclass(frozen=True)
class Elastic(Material):
    """Hooke's law, sigma = lambda tr(eps) I + 2 mu eps, isotropic.

    lambda = E nu / ((1 + nu) (1 - 2 nu)), mu = E / (2 (1 + nu)).

    Raises:
        ValueError: if E <= 0, nu is outside (-1, 0.5) or a number is not finite.
    """

    E: Parameter  # Young's modulus
    nu: Parameter  # Poisson's ratio

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    isotropic: ClassVar[bool] = True
    linear: ClassVar[bool] = True
    splits: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        "E": (0.0, math.inf, False),
        "nu": (-1.0, 0.5, False),
    }

    def __post_init__(self) -> None:
        check_fields(self)

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
