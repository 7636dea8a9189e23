# SPDX-License-Identifier: MIT
"""Laws of users in UFL for the tests; initially the stress is E times the strain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import dolfinx_mortar as dm
import ufl


def green_lagrange(u):
    """Return (F^T F - I) / 2 in the plane, as 3x3."""
    g = ufl.grad(u)
    e = (g + g.T + g.T * g) / 2
    return ufl.as_tensor([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, 0]])


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


@dataclass(frozen=True)
class Arrays(dm.materials.PointwiseLaw):
    """The neo-Hookean law by arrays; a user's."""

    E: float
    nu: float
    strain: ClassVar[str] = "finite"
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)

    @staticmethod
    def moduli(p):
        return p.E / 2 / (1 + p.nu), p.E * p.nu / (1 + p.nu) / (1 - 2 * p.nu)

    @staticmethod
    def energy(F, state, p):
        (mu, lam), log_J = Arrays.moduli(p), np.log(np.linalg.det(F))
        return mu / 2 * (np.einsum("qij,qij->q", F, F) - 3 - 2 * log_J) + lam / 2 * log_J**2

    @staticmethod
    def update(F, state, p):
        mu, lam = (m[:, None, None] for m in Arrays.moduli(p))
        G, log_J = np.linalg.inv(F).transpose(0, 2, 1), np.log(np.linalg.det(F))[:, None, None]
        swap = (mu - lam * log_J)[..., None, None] * np.einsum("qil,qkj->qijkl", G, G)
        tangent = mu[..., None, None] * np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3)) + swap
        tangent = tangent + lam[..., None, None] * np.einsum("qij,qkl->qijkl", G, G)
        return mu * (F - G) + lam * log_J * G, tangent, {}
