# SPDX-License-Identifier: MIT
"""Laws of thin plates: the strain out of the plane is what leaves no stress there.

They see the strain in the plane; what the tensor has out of it does not count. Their stress has
zeros there by construction, whatever the accuracy of anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import ufl
from dolfinx_mortar.materials.elastic import Elastic, shear_modulus
from dolfinx_mortar.materials.von_mises import (
    NORM_GUARD,
    YIELD_TOLERANCE,
    MixedVonMises,
    VonMises,
)
from ufl.core.expr import Expr

# Newton steps on 1/|eta|, nearly a line in the unknown: two or three leave round-off for Poisson's
# ratios from 0 to 0.5, four for those from -0.5.
STEPS = 4


class PlaneStressElastic(Elastic):
    """Hooke's law with sigma_zz = 0: eps_zz = -nu/(1 - nu) (eps_xx + eps_yy)."""

    splits: ClassVar[bool] = False  # the strain out of the plane is not known beforehand

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return the stress of a strain in the plane."""
        return _tensor(_Modes.of(strain) * _stiffness(p))

    @staticmethod
    def energy(strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi = 1/2 sigma:eps."""
        e = _Modes.of(strain)
        return (e * _stiffness(p)).inner(e) / 2


class _Modes(NamedTuple):
    """A symmetric tensor in the plane: (xx + yy)/sqrt2, (xx - yy)/sqrt2, xy.

    Elasticity and the norm of the deviator are diagonal in these.
    """

    s: Any
    d: Any
    t: Any

    @classmethod
    def of(cls, tensor: Expr) -> _Modes:
        """Return the modes of the part in the plane.

        Both shears, so that derivatives by the nine components are symmetric.
        """
        root = 0.5**0.5
        xx, yy = tensor[0, 0], tensor[1, 1]
        return cls(root * (xx + yy), root * (xx - yy), (tensor[0, 1] + tensor[1, 0]) / 2)

    def __mul__(self, other: Any) -> _Modes:
        """Return the product mode by mode."""
        return _Modes(*(a * b for a, b in zip(self, other, strict=True)))

    def minus(self, other: _Modes) -> _Modes:
        """Return the difference."""
        return _Modes(*(a - b for a, b in zip(self, other, strict=True)))

    def times(self, factor: Any) -> _Modes:
        """Return a multiple."""
        return _Modes(*(a * factor for a in self))

    def inner(self, other: _Modes) -> Any:
        """Return the double contraction, the shear counted twice."""
        return self.s * other.s + self.d * other.d + 2 * self.t * other.t


# Of the deviator: |dev sigma|^2 = sigma : P sigma for stresses in the plane.
_P = _Modes(1 / 3, 1.0, 1.0)


def _stiffness(p: Any) -> _Modes:
    """Return the elastic moduli of the modes."""
    mu = shear_modulus(p)
    return _Modes(p.E / (1 - p.nu), 2 * mu, 2 * mu)


def _tensor(m: _Modes, zz: Any = 0.0) -> Expr:
    """Return the 3x3 tensor of the modes."""
    root = 0.5**0.5
    xx, yy = root * (m.s + m.d), root * (m.s - m.d)
    return ufl.as_tensor([[xx, m.t, 0], [m.t, yy, 0], [0, 0, zz]])


class _Flow(NamedTuple):
    """The plastic part of a step: dep = L P eta."""

    eta: _Modes  # shifted stress at the end of the step
    norm: Any  # sqrt(eta : P eta), guarded
    L: Any  # 0 where nothing flows
    factors: _Modes  # eta / trial eta
    yields: Expr


class PlaneStressVonMises(VonMises):
    r"""`VonMises` with sigma_zz = 0, by the return in the plane of Simo and Taylor (1986).

    With eta = sigma - a P^-1 ep in the plane, |dev sigma - a ep|^2 = eta : P eta, flow
    dep = L P eta and c_i, P_i the moduli and factors of the modes i of a tensor in the plane,

        eta_i = trial eta_i / (1 + L (c_i P_i + a)),      1 / |eta|_P = (1 - H L) / (Y + H k_n),

    the last an equation for L whose left side is nearly a line. Stress and tangent follow in closed
    form; nothing differentiates the iteration.

    Source: J. C. Simo, R. L. Taylor, "A return mapping algorithm for plane stress
    elastoplasticity", Int. J. Numer. Methods Eng. 22 (1986) 649-670.
    """

    splits: ClassVar[bool] = False
    elastic_stress = staticmethod(PlaneStressElastic.elastic_stress)

    @staticmethod
    def _memory(state: Mapping[str, Expr], p: Any) -> tuple[Any, Any]:
        """Return k_n and H."""
        return 0.0, 0.0

    @classmethod
    def _flow(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> _Flow:
        """Return what flows in the step."""
        k, H = cls._memory(state, p)
        ep, c, radius = _Modes.of(state["plastic_strain"]), _stiffness(p), p.Y + H * k
        m = _Modes(*(ci * Pi + p.a for ci, Pi in zip(c, _P, strict=True)))
        shift = ep * _Modes(3 * p.a, p.a, p.a)
        trial = (_Modes.of(strain).minus(ep) * c).minus(shift)
        # m is the same for d and t: two parts of |eta|^2
        A, B = trial.s**2 / 3, trial.d**2 + 2 * trial.t**2 + (NORM_GUARD * p.Y) ** 2
        excess = ufl.sqrt(A + B) - radius
        yields = ufl.gt(excess, YIELD_TOLERANCE * radius)
        g = excess / (m.d + H)  # |dep| if all were shear: a lower bound
        L = g / (radius + H * g)
        for _ in range(STEPS):  # times (u v)^3, so that there is one root and one quotient
            u, v = 1 + m.s * L, 1 + m.d * L
            square = A * v**2 + B * u**2
            root = ufl.sqrt(square)  # u v |eta|
            slope = radius * (A * m.s * v * v**2 + B * m.d * u * u**2) + H * square * root
            L = L - square * (radius * u * v - (1 - H * L) * root) / slope
        L = ufl.conditional(yields, L, 0.0)
        u, v = 1 / (1 + m.s * L), 1 / (1 + m.d * L)
        factors = _Modes(u, v, v)
        norm = ufl.sqrt(A * factors.s**2 + B * factors.d**2)
        return _Flow(trial * factors, norm, L, factors, yields)

    @classmethod
    def stress(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return sigma = C (eps - ep)."""
        flow, ep = cls._flow(strain, state, p), _Modes.of(state["plastic_strain"])
        elastic = _Modes.of(strain).minus(ep).minus((flow.eta * _P).times(flow.L))
        return _tensor(elastic * _stiffness(p))

    @classmethod
    def tangent(cls, strain: Expr, state: Mapping[str, Expr], p: Any, direction: Expr) -> Expr:
        """Return d sigma / d eps : direction."""
        flow, c, e = cls._flow(strain, state, p), _stiffness(p), _Modes.of(direction)
        k, H = cls._memory(state, p)
        m = _Modes(*(ci * Pi + p.a for ci, Pi in zip(c, _P, strict=True)))
        change = e * c * flow.factors  # of eta, at fixed L
        Peta = flow.eta * _P
        bend = Peta.inner(flow.eta * m * flow.factors) + H * (flow.norm * flow.norm * flow.norm) / (
            p.Y + H * k
        )
        dL = ufl.conditional(flow.yields, Peta.inner(change) / bend, 0.0)
        turned = change.minus((flow.eta * m * flow.factors).times(dL))
        plastic = (turned.times(flow.L).minus(flow.eta.times(-dL))) * _P
        return _tensor(e.minus(plastic) * c)

    @classmethod
    def energy(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
        """Return psi, the energy stored and dissipated: 1/2 sigma:(eps - ep) + a/2 |ep|^2 + ..."""
        flow, (k, H) = cls._flow(strain, state, p), cls._memory(state, p)
        ep = _Modes.of(state["plastic_strain"]).minus((flow.eta * _P).times(-flow.L))
        elastic = _Modes.of(strain).minus(ep)
        back = ep.inner(ep * _Modes(3.0, 1.0, 1.0))  # |ep|^2 with the strain out of the plane
        g = flow.L * flow.norm
        stored = (elastic * _stiffness(p)).inner(elastic) / 2 + p.a / 2 * back
        return stored + H / 2 * (k + g) ** 2 + p.Y * g

    @classmethod
    def updated_state(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return the plastic strain at the end of the step; plastic flow keeps the volume."""
        flow = cls._flow(strain, state, p)
        grown = (flow.eta * _P).times(flow.L)
        zz = -(2**0.5) * grown.s
        return {"plastic_strain": state["plastic_strain"] + _tensor(grown, zz)}


class PlaneStressMixedVonMises(PlaneStressVonMises):
    """`PlaneStressVonMises` with isotropic hardening."""

    state: ClassVar[Mapping[str, tuple[int, ...]]] = MixedVonMises.state

    @staticmethod
    def _memory(state: Mapping[str, Expr], p: Any) -> tuple[Any, Any]:
        """Return k_n and H."""
        return state["accumulated_plastic_strain"], p.H

    @classmethod
    def updated_state(cls, strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return plastic strain and accumulated plastic strain at the end of the step."""
        flow = cls._flow(strain, state, p)
        k = state["accumulated_plastic_strain"] + flow.L * flow.norm
        return super().updated_state(strain, state, p) | {"accumulated_plastic_strain": k}


_LAWS: Mapping[type, type] = {
    Elastic: PlaneStressElastic,
    VonMises: PlaneStressVonMises,
    MixedVonMises: PlaneStressMixedVonMises,
}


def plane_stress_law(law: type) -> Any:
    """Return the class with the methods of a law in plane stress.

    A law of the user names it as ``plane_stress: ClassVar[type]``.

    Raises:
        ValueError: if there is none.
    """
    found = _LAWS.get(law) or vars(law).get("plane_stress")
    if found is None:
        known = ", ".join(sorted({kind.__name__ for kind in _LAWS if kind is not MixedVonMises}))
        raise ValueError(
            f"{law.__name__} does not know plane stress; {known} do, and a law of your own with a "
            "class plane_stress: ClassVar[type] whose stress is zero out of the plane."
        )
    return found
