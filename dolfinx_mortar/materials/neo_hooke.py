# SPDX-License-Identifier: MIT
"""Compressible neo-Hookean rubber."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx_mortar.materials.elastic import Elastic, lame_modulus, shear_modulus
from dolfinx_mortar.materials.protocol import Material
from dolfinx_mortar.materials.ranges import Parameter, Range, check_fields
from ufl.core.expr import Expr


@dataclass(frozen=True)
class NeoHooke(Material):
    """psi(F) = mu/2 (tr C - 3 - 2 ln J) + lambda/2 (ln J)^2, C = F^T F, J = det F.

    P = mu (F - F^-T) + lambda ln J F^-T. For small strains it is Hooke's law with E and nu. Source:
    Bonet and Wood, Nonlinear Continuum Mechanics for Finite Element Analysis (2008), eq. 6.27.

    Raises:
        ValueError: if E <= 0, nu is outside (-1, 0.5) or a number is not finite.
    """

    E: Parameter  # Young's modulus at F = I
    nu: Parameter  # Poisson's ratio at F = I

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    linear: ClassVar[bool] = False
    strain: ClassVar[str] = "finite"
    ranges: ClassVar[Mapping[str, Range]] = {
        "E": (0.0, math.inf, False),
        "nu": (-1.0, 0.5, False),
    }

    def __post_init__(self) -> None:
        check_fields(self)

    elastic_stress = staticmethod(Elastic.elastic_stress)

    @staticmethod
    def energy(F: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi per volume at X."""
        log_J = ufl.ln(ufl.det(F))
        return (
            shear_modulus(p) / 2 * (ufl.inner(F, F) - 3 - 2 * log_J)
            + lame_modulus(p) / 2 * log_J**2
        )

    @staticmethod
    def volumetric(J: Expr, p: Any) -> Expr:
        """Return the part of psi that lambda makes stiff, which only depends on the volume."""
        return lame_modulus(p) / 2 * ufl.ln(J) ** 2

    @staticmethod
    def stress(F: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return P = d psi / dF."""
        inverse = ufl.transpose(ufl.inv(F))
        log_J = ufl.ln(ufl.det(F))
        return shear_modulus(p) * (F - inverse) + lame_modulus(p) * log_J * inverse
