# SPDX-License-Identifier: MIT
"""Unilateral contact, without and with friction.

The functional of contact, with Lagrange multipliers lambda_j >= 0 and weighted gaps g_j, its first
variation and its linearisation are

    Pi_c = lambda^T g(u),     g(u) = -N^T (D - M) (X + u) = c_I - B_I u,     B_I = N^T (D - M),
    delta Pi_c = delta lambda^T g(u) - lambda^T B_I delta u,
    Delta delta Pi_c = -(delta lambda^T B_I Delta u + Delta lambda^T B_I delta u).

A step is the saddle point of J(u) - Pi_c. D, M and N are those of the present iterate: their
derivatives are left out, which is exact for frozen geometry. g_j >= 0, lambda_j >= 0 and
lambda_j g_j = 0 are bounds in the basis of `dolfinx_mortar.interfaces.basis`, w_n <= g_j / D_jj;
the reaction of that bound is D_jj lambda_j.
"""

from typing import ClassVar

from dolfinx.mesh import MeshTags
from dolfinx_mortar.interfaces.coulomb import Limit, create_law
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE
from dolfinx_mortar.interfaces.mortar_interface import MortarInterface
from dolfinx_mortar.interfaces.unilateral import Unilateral
from dolfinx_mortar.mortar.operators import SmoothSides


class Contact(Unilateral, MortarInterface):
    """Unilateral contact: w_n <= gap, pressure >= 0, pressure * opening = 0; perhaps with friction.

    ``pressure`` (traction, >= 0 in compression), ``gap`` (>= 0 when open; not-a-number at slave
    nodes that face no master) and ``active`` (1 in contact, else 0) are Functions that vanish off
    the slave side. ``force`` is the resultant exerted on the slave side, -sum_j D_jj lambda_j n_j,
    friction included. ``pressure`` and ``traction`` are per area of the slave side at X + u with
    the problem's geometry="updated", at X with "reference"; the two differ by the strain of the
    surface. Nodal values are those of the part that faces the master: where that is all of the
    slave side, their integral over it is the force, elsewhere it is larger.

    With friction, |tau| <= mu p, and where it slips tau = mu p against
    the slip of the step: the tangential motion of the slave side relative to the master since the
    last commit, R_t^T (D^-1 (D - M) (u - u_committed)). Then there are, as Functions that vanish
    off the slave side, ``traction`` (tangential, exerted on the slave side), ``step_slip`` (of the
    last step), ``slip`` (length of the slip path of each node since the start), ``status``
    (0 open, 1 stick, 2 slip), and ``dissipation``, the energy dissipated by friction since the
    start. In directions with Dirichlet data there is no friction.

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
            is none (let a Function be 0 there). Then a step is a convex minimisation. Of rings it
            is per circumference at X.

    Raises:
        ValueError: for tags that are none, unknown names, an unknown surface or angle, negative
            or infinite limits, and both ``friction`` and ``tresca``.
    """

    may_meet_itself: ClassVar[bool] = True
    lasts: ClassVar[bool] = True  # D and M at X
    spoilt = "curved sides that fit closely", "of degree 2 are far off on coarse meshes", True

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
        """Keep the description; surfaces are found when a problem takes the contact."""
        tags = {"slave": slave, "master": master}
        super().__init__(facet_tags, **tags, surface=surface, feature_angle=feature_angle)
        self.law = create_law(friction, tresca)

    def corrections(self, smooth: SmoothSides) -> dict[str, SmoothSides]:
        """Return that their heights correct the gap."""
        return {"heights_of": smooth}
