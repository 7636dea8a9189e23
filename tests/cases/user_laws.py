# SPDX-License-Identifier: MIT
"""Laws of users in UFL for the tests; initially the stress is E times the strain."""

from dataclasses import dataclass
from typing import ClassVar

import dolfinx_mortar as dm
import ufl


@dataclass(frozen=True)
class OfModulus(dm.Material):
    """What the laws below have in common: a modulus, no memory, nothing declared."""

    E: float

    state: ClassVar = {}
    linear: ClassVar = False

    @staticmethod
    def elastic_stress(strain, p):
        return p.E * strain


class Forces(OfModulus):
    """A stress but no potential."""

    @staticmethod
    def stress(strain, state, p):
        return p.E * strain


class Slack(OfModulus):
    """Elastic in the plane; pulls out of it whatever the strain there."""

    @staticmethod
    def stress(strain, state, p):
        out = ufl.as_tensor([[0, 0, 0], [0, 0, 0], [0, 0, 1]])
        return p.E * (strain + out * (1 + strain[2, 2] ** 2))


class Softening(OfModulus):
    """A potential that is concave beyond a strain of 0.05 or so."""

    @staticmethod
    def energy(strain, state, p):
        square = ufl.inner(strain, strain)
        return p.E * (square / 2 - 100 * square**2)


@dataclass(frozen=True)
class Cubic(OfModulus):
    """Cubic hardening of the strain along a direction."""

    c: float

    @staticmethod
    def energy(strain, state, p):
        n = ufl.as_vector([0.6, 0.8, 0.0])
        along = ufl.dot(n, strain * n)
        return p.E / 2 * ufl.inner(strain, strain) + p.c * along**4


class Unturned(OfModulus):
    """An energy of F that sees rotations, which no body may have."""

    strain: ClassVar = "finite"

    @staticmethod
    def energy(F, state, p):
        H = F - ufl.Identity(3)
        return p.E / 2 * ufl.inner(H, H)


@dataclass(frozen=True)
class OfHooke(dm.Material):
    """What laws of Hooke's two numbers share."""

    E: float
    nu: float

    state: ClassVar = {}
    linear: ClassVar = False
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)


class SaintVenantKirchhoff(OfHooke):
    """Hooke's law between Green's strain (F^T F - I)/2 and the second Piola-Kirchhoff stress."""

    strain: ClassVar = "finite"

    @staticmethod
    def energy(F, state, p):
        return dm.Elastic.energy((F.T * F - ufl.Identity(3)) / 2, state, p)
