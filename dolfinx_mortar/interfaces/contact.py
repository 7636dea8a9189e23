# SPDX-License-Identifier: MIT
"""Unilateral contact, between two sides and as a base class (theory.md, Equations 12 to 15)."""

from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.interfaces.constraints import Limit, create_law
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE, Interface
from dolfinx_mortar.interfaces.mortar_interface import MortarInterface
from dolfinx_mortar.interfaces.results import NoResult
from dolfinx_mortar.spaces import check_mesh

# Least free part of a node's normal for a multiplier, which may exceed the free force tenfold.
MIN_FREE_NORMAL = 0.1


class Unilateral(Interface):
    """Bounds w_n <= gap, pressure >= 0, pressure * opening = 0; perhaps with friction."""

    unilateral = True

    def __repr__(self) -> str:
        name = super().__repr__()
        if self.law is None:
            return name
        value = self.law.value
        said = f"{value:g}" if isinstance(value, float) else type(value).__name__
        return f"{name[:-1]}, {self.law.name}={said})"

    def given(self) -> dict[str, Any]:
        """See `Interface.given`."""
        return super().given() | {"friction": self.friction, "tresca": self.tresca}

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Raise a ValueError for limits of friction on another mesh than V's."""
        if self.law is not None and isinstance(self.law.value, fem.Function):
            check_mesh(self.law.name, self.law.value, V)  # Constants need no mesh

    @property
    def friction(self) -> Limit | None:
        """Coefficient of friction, or None."""
        return self._limit("friction")

    @property
    def tresca(self) -> Limit | None:
        """Limit of the tangential traction, or None."""
        return self._limit("tresca")

    def _limit(self, name: str) -> Limit | None:
        return self.law.value if self.law is not None and self.law.name == name else None

    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Nodes (n, 1) whose normal is not prescribed."""
        return np.asarray((left >= MIN_FREE_NORMAL)[:, None])

    def _of_friction(self, name: str) -> fem.Function:
        if self.law is None:
            raise NoResult(self, name, "it has no friction: give friction= or tresca=")
        return self._function(name)

    @property
    def traction(self) -> fem.Function:
        """Tangential traction (d,) exerted on the slave side."""
        return self._of_friction("traction")

    @property
    def step_slip(self) -> fem.Function:
        """Tangential motion (d,) of the slave side along the master in the last step."""
        return self._of_friction("step_slip")

    @property
    def slip(self) -> fem.Function:
        """Accumulated slip of the nodes since the start."""
        return self._of_friction("slip")

    @property
    def status(self) -> fem.Function:
        """0 open, 1 stick, 2 slip."""
        return self._of_friction("status")

    @property
    def dissipation(self) -> float:
        """Energy dissipated by friction since the start."""
        self._of_friction("status")
        return self.dissipated


class Contact(Unilateral, MortarInterface):
    """Unilateral contact, perhaps with friction.

    At slave node j with the outward normal n_j, the dual function Phi_j and the multiplier lambda_j

        g_j = n_j . int Phi_j (x_m - x_s),     g_j >= 0,  lambda_j >= 0,  lambda_j g_j = 0,

    x_m being the projection of x_s on the master side along the slave normal.
    Results are Functions that vanish off the slave side: ``pressure`` (>= 0 in compression),
    ``gap`` (>= 0 when open; not-a-number at nodes that face no master), ``active`` (1 in contact,
    else 0). ``force`` is the resultant on the slave side, -sum_j D_jj lambda_j n_j plus friction.
    ``pressure`` and ``traction`` are per area of the slave side that faces the master, at X + u, or
    at X with geometry="reference": their integral exceeds the force unless all of it does.
    Friction: abs(tau) <= mu p, with equality against the slip R_t^T (D^-1 (D - M) (u -
    u_committed)). Further results: ``traction`` (tangential, on the slave side), ``step_slip``,
    ``slip`` (lengths), ``status`` and ``dissipation``. Where Dirichlet data prescribe the slip,
    friction reaches its limit over a twentieth of a facet.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag or name (see `Tags`) of the side with the multipliers.
        master: tag or name of the other side; equal to ``slave`` for self-contact.
        surface: "smooth" measures the gap between smooth surfaces through the nodes, g_j - sum_q w
            Phi_j (h_s + h_m) with the heights h of `dolfinx_mortar.geometry.curvature`; "facets"
            between the facets, as the paper.
        feature_angle: least angle of an edge between facets in degrees, for smooth surfaces.
        friction: Coulomb's coefficient mu: a number, a scalar Constant, or a scalar Lagrange
            Function on this mesh, read at every step.
        tresca: limit of the tangential traction instead, at every slave node that faces the master;
            a step is then a convex minimisation. In axisymmetry per circumference at X for small
            strains.
    Source: the paper, eqs. 12 to 20; friction: S. Hueeber, G. Stadler, B. Wohlmuth, SIAM J. Sci.
    Comput. 30 (2008) 572-596; M. Gitterle, A. Popp, M. W. Gee, W. A. Wall, Int. J. Numer. Methods
    Engrg. 84 (2010) 543-571.

    Raises:
        ValueError: for an invalid argument, and both ``friction`` and ``tresca``.
    """

    def __init__(
        self,
        facet_tags: MeshTags,
        *,
        slave: int | str,
        master: int | str,
        surface: str = "smooth",
        feature_angle: float = FEATURE_ANGLE,
        friction: Limit | None = None,
        tresca: Limit | None = None,
    ) -> None:
        tags = {"slave": slave, "master": master}
        super().__init__(facet_tags, **tags, surface=surface, feature_angle=feature_angle)
        self.law = create_law(friction, tresca)

    @property
    def meets_itself(self) -> bool:
        """Whether slave and master are one surface."""
        return self.slave == self.master
