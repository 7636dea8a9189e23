# SPDX-License-Identifier: MIT
"""Linear elasticity, isotropic and orthotropic, and rubber."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import ufl
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.materials import logarithms
from dolfinx_mortar.materials.logarithmic import as_tensors
from dolfinx_mortar.materials.protocol import (
    FINITE,
    POSITIVE,
    CheckedLaw,
    Parameter,
    PointwiseLaw,
    Range,
    check_fields,
)
from dolfinx_mortar.materials.tensor import GRADIENT, INDEX, upper_triangle
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
        "E": POSITIVE,
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
        **dict.fromkeys(("E1", "E2", "E3", "G12", "G13", "G23"), POSITIVE),
        **dict.fromkeys(("nu12", "nu13", "nu23", "yaw", "pitch", "roll"), FINITE),
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

    def turn(i: int, j: int, angle: Expr) -> Expr:
        R: Any = np.eye(3).tolist()
        R[i][i] = R[j][j] = ufl.cos(angle)
        R[i][j], R[j][i] = -ufl.sin(angle), ufl.sin(angle)
        return ufl.as_matrix(R)

    return turn(0, 1, p.yaw) * turn(2, 0, p.pitch) * turn(1, 2, p.roll)


@dataclass(frozen=True)
class NeoHooke(CheckedLaw):
    """psi(F) = mu/2 (tr C - 3 - 2 ln J) + lambda/2 (ln J)^2, C = F^T F, J = det F.

    P = mu (F - F^-T) + lambda ln J F^-T. For small strains it is Hooke's law with E and nu. Source:
    Bonet and Wood, Nonlinear Continuum Mechanics for Finite Element Analysis (2008), eq. 6.27.

    Raises:
        ValueError: if E <= 0, nu is outside (-1, 0.5) or a number is not finite.
    """

    E: Parameter  # Young's modulus at F = I
    nu: Parameter  # Poisson's ratio at F = I

    strain: ClassVar[str] = "finite"
    ranges: ClassVar[Mapping[str, Range]] = Elastic.ranges
    elastic_stress = staticmethod(Elastic.elastic_stress)

    @staticmethod
    def energy(F: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi."""
        log_J = ufl.ln(ufl.det(F))
        isochoric = shear_modulus(p) / 2 * (ufl.inner(F, F) - 3 - 2 * log_J)
        return isochoric + lame_modulus(p) / 2 * log_J**2

    @staticmethod
    def volumetric(J: Expr, p: Any) -> Expr:
        """Part of psi with the factor lambda."""
        return lame_modulus(p) / 2 * ufl.ln(J) ** 2

    @staticmethod
    def stress(F: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return P."""
        inverse = ufl.transpose(ufl.inv(F))
        log_J = ufl.ln(ufl.det(F))
        return shear_modulus(p) * (F - inverse) + lame_modulus(p) * log_J * inverse


@dataclass(frozen=True)
class MooneyRivlin(CheckedLaw):
    """psi(F) = C10 (I1 - 3) + C01 (I2 - 3) + K/2 (J - 1)^2, J = det F.

    I1 = tr C / J^(2/3) and I2 = (tr(C)^2 - tr(C^2)) / (2 J^(4/3)), C = F^T F, are independent of
    the volume. The shear modulus at F = I is 2 (C10 + C01); C01 = 0 is a neo-Hookean rubber.
    Source: Holzapfel, Nonlinear Solid Mechanics (2000), sections 6.4 and 6.5.

    Raises:
        ValueError: if K <= 0, C10 + C01 <= 0 or a number is not finite.
    """

    C10: Parameter  # stress
    C01: Parameter  # stress
    K: Parameter  # bulk modulus

    strain: ClassVar[str] = "finite"
    ranges: ClassVar[Mapping[str, Range]] = {
        "C10": FINITE,
        "C01": FINITE,
        "K": POSITIVE,
    }

    @staticmethod
    def conditions(p: Any) -> dict[str, Any]:
        """Positive shear modulus."""
        return {"C10 + C01 > 0": p.C10 + p.C01 > 0.0}

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain."""
        return _elastic_stress(strain, p.K, 4 * (p.C10 + p.C01))

    @staticmethod
    def energy(F: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi."""
        C, J = ufl.transpose(F) * F, ufl.det(F)
        first = ufl.tr(C) * J ** (-2 / 3)
        second = (ufl.tr(C) ** 2 - ufl.inner(C, C)) / 2 * J ** (-4 / 3)
        return p.C10 * (first - 3) + p.C01 * (second - 3) + MooneyRivlin.volumetric(J, p)

    @staticmethod
    def volumetric(J: Expr, p: Any) -> Expr:
        """Return K/2 (J - 1)^2."""
        return p.K / 2 * (J - 1) ** 2


@dataclass(frozen=True)
class Ogden(PointwiseLaw):
    """psi(F) = sum_i mu_i / alpha_i (a_1^alpha_i + a_2^alpha_i + a_3^alpha_i - 3) + K/2 (J - 1)^2.

    a_k = lambda_k / J^(1/3) are the isochoric principal stretches, J = det F. The shear modulus at
    F = I is sum_i mu_i alpha_i / 2. A law of arrays. Source: Ogden, Proc. R. Soc. Lond. A 326
    (1972) 565-584; Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5.

    Raises:
        ValueError: naming a parameter out of its range, or a shear modulus that is not positive.
    """

    mu: tuple[Parameter, ...]  # stress
    alpha: tuple[Parameter, ...]
    K: Parameter  # bulk modulus

    strain: ClassVar[str] = "finite"
    ranges: ClassVar[Mapping[str, Range]] = {"K": POSITIVE}

    def __post_init__(self) -> None:
        given = self.mu, self.alpha
        if not all(isinstance(v, tuple) for v in given) or len(self.mu) != len(self.alpha):
            raise ValueError(
                f"Ogden: mu = {self.mu!r} and alpha = {self.alpha!r} must be tuples of one length, "
                "such as mu=(0.63, -0.01), alpha=(1.3, -2.0)."
            )
        numbers = [v for v in (*self.mu, *self.alpha) if isinstance(v, Real)]
        if not self.mu or not all(math.isfinite(v) for v in numbers):
            raise ValueError(f"Ogden: mu = {self.mu!r}, alpha = {self.alpha!r} must be finite.")
        check_fields(self)

    @staticmethod
    def conditions(p: Any) -> dict[str, Any]:
        """Positive shear modulus, exponents that are not zero."""
        rules = {f"alpha[{i}] is not 0": alpha != 0.0 for i, alpha in enumerate(p.alpha)}
        return {"sum of mu * alpha > 0": _twice_shear_modulus(p) > 0.0} | rules

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain."""
        return _elastic_stress(strain, p.K, _twice_shear_modulus(p))

    @staticmethod
    def energy(F: Floats, state: Mapping[str, Floats], p: SimpleNamespace) -> Floats:
        """Return psi (q,)."""
        a, J = np.linalg.svd(F, compute_uv=False), np.linalg.det(F)
        psi = p.K / 2 * (J - 1) ** 2
        for mu, alpha in zip(p.mu, p.alpha, strict=True):
            powers = np.expm1(alpha[:, None] * np.log(a / np.cbrt(J)[:, None]))
            psi = psi + mu / alpha * powers.sum(axis=1)
        return np.asarray(psi)

    volumetric = staticmethod(MooneyRivlin.volumetric)

    @staticmethod
    def update(
        F: Floats, state: Mapping[str, Floats], p: SimpleNamespace
    ) -> tuple[Floats, Floats, dict[str, Floats]]:
        """P (q, 3, 3) and dP/dF (q, 3, 3, 3, 3) from the principal Kirchhoff stresses."""
        q = len(F)
        x, logs, *tensors = np.empty((q, 3)), np.empty((q, 3)), *np.empty((3, q, 3, 3))
        logarithms.decompose(F - np.eye(3), np.empty((0, 3, 3)), x, logs, *tensors)
        D = np.eye(3) - 1 / 3
        e, J = logs @ D, np.exp(logs.sum(axis=1))[:, None]
        T, L, G = p.K[:, None] * (J - 1) * J * np.ones(3), np.zeros((q, 3, 3)), np.zeros((q, 3))
        L += (p.K[:, None] * (2 * J - 1) * J)[..., None]
        first, second = np.array(INDEX[3:]).T
        apart = e[:, first] - e[:, second]
        for mu, alpha in zip(p.mu, p.alpha, strict=True):
            power = mu[:, None] * np.exp(alpha[:, None] * e)
            T += power @ D
            L += D @ ((alpha[:, None] * power)[..., None] * D)
            # exact for coincident stretches
            t = alpha[:, None] * apart
            share = np.where(t == 0.0, 1.0, np.expm1(t) / np.where(t == 0.0, 1.0, t))
            G += alpha[:, None] / 2 * power[:, second] * share
        P, A = np.empty((q, 9)), np.empty((q, 45))
        law = np.hstack([T, L.reshape(q, 9), G])
        logarithms.respond(INDEX, True, law, x, logs, *tensors, P, A)
        return (*as_tensors(P, A, GRADIENT[3], upper_triangle(9)), {})


def _twice_shear_modulus(p: Any) -> Any:
    return sum(mu * alpha for mu, alpha in zip(p.mu, p.alpha, strict=True))


def _elastic_stress(strain: Expr, K: Any, twice_mu: Any) -> Expr:
    return K * ufl.tr(strain) * ufl.Identity(3) + twice_mu * ufl.dev(strain)
