# SPDX-License-Identifier: MIT
"""Rubber by Mooney and Rivlin, nearly incompressible."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx_mortar.materials.protocol import Material
from dolfinx_mortar.materials.ranges import Parameter, Range, check_fields
from ufl.core.expr import Expr


@dataclass(frozen=True)
class MooneyRivlin(Material):
    """psi(F) = C10 (I1 - 3) + C01 (I2 - 3) + K/2 (J - 1)^2, J = det F.

    I1 = tr C / J^(2/3) and I2 = (tr(C)^2 - tr(C^2)) / (2 J^(4/3)) see no change of volume,
    C = F^T F. The shear modulus at F = I is 2 (C10 + C01); C01 = 0 is a neo-Hookean rubber. Source:
    Holzapfel, Nonlinear Solid Mechanics (2000), sections 6.4 and 6.5.

    Raises:
        ValueError: if K <= 0, C10 + C01 <= 0 or a number is not finite.
    """

    C10: Parameter  # stress
    C01: Parameter  # stress
    K: Parameter  # bulk modulus

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    linear: ClassVar[bool] = False
    strain: ClassVar[str] = "finite"
    ranges: ClassVar[Mapping[str, Range]] = {
        "C10": (-math.inf, math.inf, False),
        "C01": (-math.inf, math.inf, False),
        "K": (0.0, math.inf, False),
    }

    def __post_init__(self) -> None:
        check_fields(self)

    @staticmethod
    def conditions(p: Any) -> dict[str, Any]:
        """Return what several parameters must satisfy."""
        return {"C10 + C01 > 0": p.C10 + p.C01 > 0.0}

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain of a small strain."""
        mu = 2 * (p.C10 + p.C01)
        return p.K * ufl.tr(strain) * ufl.Identity(3) + 2 * mu * ufl.dev(strain)

    @staticmethod
    def energy(F: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi per volume at X."""
        C, J = ufl.transpose(F) * F, ufl.det(F)
        first = ufl.tr(C) * J ** (-2 / 3)
        second = (ufl.tr(C) ** 2 - ufl.inner(C, C)) / 2 * J ** (-4 / 3)
        return p.C10 * (first - 3) + p.C01 * (second - 3) + MooneyRivlin.volumetric(J, p)

    @staticmethod
    def volumetric(J: Expr, p: Any) -> Expr:
        """Return the part of psi that only depends on the volume."""
        return p.K / 2 * (J - 1) ** 2
