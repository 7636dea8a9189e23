# SPDX-License-Identifier: MIT
"""Laws of time: Norton's creep, and linear viscoelasticity.

Their time step ``dt`` is a Constant, which `load_steps` sets to the difference of two levels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from dolfinx_mortar.common.arrays import EPS
from dolfinx_mortar.materials.elastic import Elastic, shear_modulus
from dolfinx_mortar.materials.protocol import (
    NOT_NEGATIVE,
    PLASTIC,
    POSITIVE,
    CheckedLaw,
    Parameter,
    Range,
)
from ufl.core.expr import Expr

ROUNDS = 6  # of Newton's method, to round-off for exponents of 1 to 20


@dataclass(frozen=True)
class Norton(CheckedLaw):
    """Secondary creep: the strain rate in tension is A q^n at the von Mises stress q.

    The creep strain e (state ``plastic_strain``) follows by the implicit rule of Euler,

        sigma = C (eps - e),     e - e_n = dt 3/2 A q^(n - 1) dev sigma,

    whose only unknown is x = q / q_trial, x + c x^n = 1, c = 3 mu dt A q_trial^(n - 1).

    Args:
        E, nu: Young's modulus and Poisson's ratio.
        A: strain per time at the stress 1.
        n: exponent, at least 1.
        dt: time step, >= 0, usually a Constant.
    Source: F. H. Norton, The Creep of Steel at High Temperatures, McGraw-Hill, 1929.

    Raises:
        ValueError: naming a parameter that is out of its range.
    """

    E: Parameter
    nu: Parameter
    A: Parameter
    n: Parameter
    dt: Parameter

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {PLASTIC: (3, 3)}
    isotropic: ClassVar[bool] = True
    elastic_stress = staticmethod(Elastic.elastic_stress)
    ranges: ClassVar[Mapping[str, Range]] = {
        **Elastic.ranges,
        "A": NOT_NEGATIVE,
        "n": (1.0, math.inf, True),
        "dt": NOT_NEGATIVE,
    }

    @staticmethod
    def _creep(strain: Expr, state: Mapping[str, Expr], p: Any) -> tuple[Expr, Expr]:
        """Trial deviator of the elastic strain, and the part of it that creeps."""
        e, mu = ufl.dev(strain - state[PLASTIC]), shear_modulus(p)
        q = ufl.sqrt(6 * mu**2 * ufl.inner(e, e) + (EPS * p.E) ** 2)
        c = 3 * mu * p.dt * p.A * q ** (p.n - 1)
        x = ufl.min_value(1.0, (c + EPS) ** (-1 / p.n))  # above the root of a convex function
        for _ in range(ROUNDS):
            x -= (x + c * x**p.n - 1) / (1 + p.n * c * x ** (p.n - 1))
        return e, 1 - x

    @classmethod
    def stress(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return sigma = C (eps - e_n) - 2 mu (e - e_n)."""
        e, part = cls._creep(strain, state, p)
        elastic = Elastic.elastic_stress(strain - state[PLASTIC], p)
        return elastic - 2 * shear_modulus(p) * part * e

    @classmethod
    def updated_state(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Creep strain at the end of the step."""
        e, part = cls._creep(strain, state, p)
        return {PLASTIC: state[PLASTIC] + part * e}


@dataclass(frozen=True)
class Viscoelastic(CheckedLaw):
    """Standard linear solid in shear: a spring beside a spring in series with a dashpot.

        sigma = C (eps - g v),     tau dv/dt = dev eps - v,

    with the viscous strain v by the implicit rule of Euler. The shear modulus falls from mu to (1 -
    g) mu with the relaxation time tau; the bulk modulus stays.

    Args:
        E, nu: Young's modulus and Poisson's ratio at once after loading.
        g: share of the shear modulus that relaxes, 0 to 1.
        tau: relaxation time at constant strain.
        dt: time step, >= 0, usually a Constant.

    Raises:
        ValueError: naming a parameter that is out of its range.
    """

    E: Parameter
    nu: Parameter
    g: Parameter
    tau: Parameter
    dt: Parameter

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {"viscous_strain": (3, 3)}
    elastic_stress = staticmethod(Elastic.elastic_stress)
    ranges: ClassVar[Mapping[str, Range]] = {
        **Elastic.ranges,
        "g": (0.0, 1.0, True),
        "tau": POSITIVE,
        "dt": NOT_NEGATIVE,
    }

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Viscous strain at the end of the step."""
        v = state["viscous_strain"]
        return {"viscous_strain": v + p.dt / (p.tau + p.dt) * (ufl.dev(strain) - v)}

    @classmethod
    def stress(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return C (eps - g v)."""
        v = cls.updated_state(strain, state, p)["viscous_strain"]
        return Elastic.elastic_stress(strain, p) - 2 * shear_modulus(p) * p.g * v
