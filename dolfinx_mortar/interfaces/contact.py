# SPDX-License-Identifier: MIT
"""Unilateral contact with and without friction: between two sides, and the base of all kinds.

The functional of contact, with Lagrange multipliers lambda_j >= 0 and weighted gaps g_j, its first
variation and its linearisation are

    Pi_c = lambda^T g(u),     g(u) = -N^T (D - M) (X + u) = c_I - B_I u,     B_I = N^T (D - M),
    delta Pi_c = delta lambda^T g(u) - lambda^T B_I delta u,
    Delta delta Pi_c = -(delta lambda^T B_I Delta u + Delta lambda^T B_I delta u).

A step is the saddle point of J(u) - Pi_c. D, M and N are those of the present iterate. Their
derivatives, zero for frozen geometry, are no part of these rows: where the fixed point of the
geometry is slow, `dolfinx_mortar.interfaces.moving_geometry` adds them. g_j >= 0, lambda_j >= 0 and
lambda_j g_j = 0 are bounds in the basis of `dolfinx_mortar.interfaces.basis`, w_n <= g_j / D_jj;
the reaction of that bound is D_jj lambda_j.
"""

from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.constraints import Limit, create_law
from dolfinx_mortar.interfaces.coupling import Frame, normal_frames
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE, Interface
from dolfinx_mortar.interfaces.mortar_interface import MortarInterface
from dolfinx_mortar.interfaces.results import NoResult
from dolfinx_mortar.mortar.operators import SmoothSides
from dolfinx_mortar.spaces import check_mesh

# A slave node of whose normal Dirichlet data leave less than this share, at more than 84 degrees,
# carries no multiplier: it would balance the forces in what is left, ten times as large.
MIN_FREE_NORMAL = 0.1


class Unilateral(Interface):
    """w_n <= gap, pressure >= 0, pressure * opening = 0; perhaps with friction, see `Contact`."""

    unilateral = True

    def __repr__(self) -> str:
        name = super().__repr__()
        if self.law is None:
            return name
        value = self.law.value
        said = f"{value:g}" if isinstance(value, float) else type(value).__name__
        return f"{name[:-1]}, {self.law.name}={said})"

    def given(self) -> dict[str, Any]:
        """Return what all ranks have to give the same, by name; see `agreement`."""
        return super().given() | {"friction": self.friction, "tresca": self.tresca}

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Raise a ValueError for limits of friction on another mesh than V's."""
        if self.law is not None and isinstance(self.law.value, fem.Function):
            check_mesh(self.law.name, self.law.value, V)  # a Constant is a number

    @property
    def friction(self) -> Limit | None:
        """The coefficient of friction as given; None if there is none."""
        return self._limit("friction")

    @property
    def tresca(self) -> Limit | None:
        """The limit of the tangential traction as given; None if there is none."""
        return self._limit("tresca")

    def _limit(self, name: str) -> Limit | None:
        return self.law.value if self.law is not None and self.law.name == name else None

    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Return (n, 1): nodes whose normal is not taken by Dirichlet data."""
        return np.asarray((left >= MIN_FREE_NORMAL)[:, None])

    def frame(self, normals: Floats, kept: Bools, fixed: Bools) -> Frame:
        """Return frames with the normal first, which is constrained; Cartesian where not kept.

        With friction the tangents are constrained, too, but for prescribed ones.
        """
        R, slot, directions = normal_frames(normals, kept[:, 0], fixed)
        if self.law is not None:
            prescribed = (slot[:, :, None] == np.arange(R.shape[1])).any(axis=1)
            directions = kept & ~prescribed
        return Frame(R, slot, directions, np.where(kept, normals, 0.0))

    def blocks(self, P: Floats, frame: Frame, row: Ints) -> Floats:
        """Return P_jl R_j S_j R_j^-1, without friction P_jl r_j n_j^T, r_j the first of R_j."""
        if self.law is None:
            r, n = frame.R[row, :, 0], frame.normals[row]
            return np.asarray(P[:, 0, None, None] * r[:, :, None] * n[:, None, :])
        R = frame.R * frame.directions[:, None, :]
        return np.asarray(P[:, 0, None, None] * (R @ np.linalg.inv(frame.R))[row])

    # -- results ---------------------------------------------------------------------------------

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
        """Length of the slip path of the nodes since the start, the last step included."""
        return self._of_friction("slip")

    @property
    def status(self) -> fem.Function:
        """0 open, 1 stick, 2 slip."""
        return self._of_friction("status")

    @property
    def dissipation(self) -> float:
        """Energy dissipated by friction since the start, the last step included."""
        self._of_friction("status")
        return self.dissipated


class Contact(Unilateral, MortarInterface):
    """Unilateral contact: w_n <= gap, pressure >= 0, pressure * opening = 0; perhaps with friction.

    At slave node j, with the outward normal n_j and the dual function Phi_j, the weighted gap and
    the conditions on it and the Lagrange multiplier lambda_j are

        g_j = n_j . int Phi_j (x_m - x_s),     g_j >= 0,  lambda_j >= 0,  lambda_j g_j = 0,

    with x_m the projection of x_s on the master side along the slave normal.

    ``pressure`` (traction, >= 0 in compression), ``gap`` (>= 0 when open; not-a-number at slave
    nodes that face no master) and ``active`` (1 in contact, else 0) are Functions that vanish off
    the slave side. ``force`` is the resultant exerted on the slave side, -sum_j D_jj lambda_j n_j,
    friction included. ``pressure`` and ``traction`` are per area of the slave side at X + u with
    the problem's geometry="updated", at X with "reference"; the two differ by the strain of the
    surface. Nodal values are those of the part that faces the master, also at a node just beyond
    its end, which shows the traction there: where that part is all of the slave side, their
    integral over it is the force, elsewhere it is larger.

    With friction abs(tau) <= mu p, and where the sides slip tau has this size and opposes the slip
    of the step: the tangential motion of the slave side relative to the master since the last
    commit, R_t^T (D^-1 (D - M) (u - u_committed)). Then there are, as Functions that vanish off
    the slave side, ``traction`` (tangential, exerted on the slave side), ``step_slip`` (a length,
    of the last step), ``slip`` (length of the slip path of each node since the start), ``status``
    (0 open, 1 stick, 2 slip), and ``dissipation``, the energy dissipated by friction since the
    start. Where Dirichlet data prescribe the slip of a node, friction opposes it, and grows to its
    limit over the slip of a twentieth of a facet.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag of the side that carries the multipliers, or its name, see `Tags`.
        master: tag or name of the other side; that of the slave for a surface that folds and meets
            itself, which is divided into slaves and masters at each search, see
            `dolfinx_mortar.mortar.self_contact`.
        surface: "smooth" measures the gap between the smooth surfaces through the nodes of the
            facets, g_j - sum_q w Phi_j (h_s + h_m) with the heights h of
            `dolfinx_mortar.geometry.curvature`; "facets" between the facets, as the paper does.
            D, M and N are the same.
        feature_angle: degrees between two facets from which on they meet in an edge, which stays
            one; for smooth surfaces.
        friction: coefficient mu of Coulomb's law: a number, a scalar Constant, or a scalar
            Lagrange Function on the mesh of the displacement; their values are read anew at every
            step, and are what may change. 0 is no friction.
        tresca: limit of the tangential traction instead, of the same kinds: given friction, which
            acts at every slave node that faces the master, whatever the pressure, also where there
            is none (let a Function be 0 there). Then a step is a convex minimisation. In
            axisymmetry it is per circumference at X where strains are small.

    Source: the paper, eqs. 12 to 20; friction: S. Hueeber, G. Stadler, B. Wohlmuth, SIAM J. Sci.
    Comput. 30 (2008) 572-596; M. Gitterle, A. Popp, M. W. Gee, W. A. Wall, Int. J. Numer. Methods
    Engrg. 84 (2010) 543-571.

    Raises:
        ValueError: for tags that are none, unknown names, an unknown surface or angle, negative
            or infinite limits, and both ``friction`` and ``tresca``.
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
        """Whether one tag is both sides, see `mortar.self_contact`."""
        return self.slave == self.master

    def corrections(self, smooth: SmoothSides) -> dict[str, SmoothSides]:
        """Return the argument by which heights of smooth surfaces correct the gap."""
        return {"heights_of": smooth}
