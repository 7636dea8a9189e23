# SPDX-License-Identifier: MIT
"""Linear elasticity, isotropic and orthotropic."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx_mortar.materials.protocol import CheckedLaw, Parameter, Range
from ufl.core.expr import Expr


def shear_modulus(p: Any) -> Any:
    """Return mu = E / (2 (1 + nu))."""
    return p.E / (2 * (1 + p.nu))


def lame_modulus(p: Any) -> Any:
    """Return lambda = E nu / ((1 + nu)(1 - 2 nu))."""
    return p.E * p.nu / ((1 + p.nu) * (1 - 2 * p.nu))


def bulk_modulus(p: Any) -> Any:
    """Return K = E / (3 (1 - 2 nu))."""
    return p.E / (3 * (1 - 2 * p.nu))


@dataclass(frozen=True)
class Elastic(CheckedLaw):
    """Hooke's law, sigma = lambda tr(eps) I + 2 mu eps, isotropic.

    lambda = E nu / ((1 + nu) (1 - 2 nu)), mu = E / (2 (1 + nu)).

    Raises:
        ValueError: if E <= 0, nu is outside (-1, 0.5) or a number is not finite.
    """

    E: Parameter  # Young's modulus
    nu: Parameter  # Poisson's ratio

    isotropic: ClassVar[bool] = True
    linear: ClassVar[bool] = True
    splits: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        "E": (0.0, math.inf, False),
        "nu": (-1.0, 0.5, False),
    }

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


@dataclass(frozen=True)
class Orthotropic(CheckedLaw):
    """Hooke's law with three planes of symmetry, in axes 1, 2, 3 of the material.

        eps_11 = sigma_11 / E1 - nu12 sigma_22 / E1 - nu13 sigma_33 / E1  (nu21 / E2 = nu12 / E1 ..)
        eps_12 = sigma_12 / (2 G12), ..

    The axes are x, y, z turned by yaw about z, pitch about the new y, and roll about the new x
    (radians, right hand): the columns of Rz(yaw) Ry(pitch) Rx(roll). In the plane use yaw alone.

    Source: R. M. Jones, Mechanics of Composite Materials (1999), section 2.3.

    Raises:
        ValueError: naming a modulus that is out of its range, and if the energy is not positive.
    """

    E1: Parameter  # Young's modulus along axis 1
    E2: Parameter  # along axis 2
    E3: Parameter  # along axis 3
    nu12: Parameter  # contraction along 2 by stress along 1
    nu13: Parameter  # along 3 by stress along 1
    nu23: Parameter  # along 3 by stress along 2
    G12: Parameter  # shear modulus in the plane of axes 1 and 2
    G13: Parameter  # of axes 1 and 3
    G23: Parameter  # of axes 2 and 3
    yaw: Parameter = 0.0  # radians about z
    pitch: Parameter = 0.0  # radians about the new y
    roll: Parameter = 0.0  # radians about the new x

    linear: ClassVar[bool] = True
    ranges: ClassVar[Mapping[str, Range]] = {
        **dict.fromkeys(("E1", "E2", "E3", "G12", "G13", "G23"), (0.0, math.inf, False)),
        **dict.fromkeys(
            ("nu12", "nu13", "nu23", "yaw", "pitch", "roll"), (-math.inf, math.inf, False)
        ),
    }

    @staticmethod
    def conditions(p: Any) -> dict[str, Any]:
        """Positive leading minors of the compliance."""
        coupled = 2 * p.nu12 * p.nu23 * p.nu13 * p.E3 / p.E1
        pairs = p.nu12**2 * p.E2 / p.E1 + p.nu23**2 * p.E3 / p.E2 + p.nu13**2 * p.E3 / p.E1
        return {
            "nu12^2 < E1 / E2": p.nu12**2 < p.E1 / p.E2,
            "nu13^2 < E1 / E3": p.nu13**2 < p.E1 / p.E3,
            "nu23^2 < E2 / E3": p.nu23**2 < p.E2 / p.E3,
            "nu12^2 E2 / E1 + nu23^2 E3 / E2 + nu13^2 E3 / E1 + 2 nu12 nu23 nu13 E3 / E1 < 1": (
                pairs + coupled < 1
            ),
        }

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain."""
        R = _axes(p)
        e = R.T * strain * R
        a, b, c = -p.nu12 / p.E1, -p.nu13 / p.E1, -p.nu23 / p.E2
        compliance = ufl.as_tensor([[1 / p.E1, a, b], [a, 1 / p.E2, c], [b, c, 1 / p.E3]])
        normal = ufl.inv(compliance) * ufl.as_vector([e[i, i] for i in range(3)])
        s1, s2, s3 = (normal[i] for i in range(3))
        s12, s13, s23 = 2 * p.G12 * e[0, 1], 2 * p.G13 * e[0, 2], 2 * p.G23 * e[1, 2]
        return R * ufl.as_tensor([[s1, s12, s13], [s12, s2, s23], [s13, s23, s3]]) * R.T

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi = 1/2 eps:C:eps."""
        return ufl.inner(Orthotropic.elastic_stress(strain, p), strain) / 2

    @staticmethod
    def stress(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return C : strain."""
        return Orthotropic.elastic_stress(strain, p)


def _axes(p: Any) -> Expr:
    """Axes of the material as columns (3, 3)."""
    (cz, sz), (cy, sy), (cx, sx) = ((ufl.cos(t), ufl.sin(t)) for t in (p.yaw, p.pitch, p.roll))
    yaw = ufl.as_tensor([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    pitch = ufl.as_tensor([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    roll = ufl.as_tensor([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    return yaw * pitch * roll
