# SPDX-License-Identifier: MIT
"""Interfaces of two sides coupled by dual mortar operators, and unilateral contact.

See theory.md, Equations 12 to 15.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.common.arguments import check, one_of
from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.common.spaces import check_mesh
from dolfinx_mortar.common.tags import label, tag_of
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.interfaces.constraints import Limit, create_law
from dolfinx_mortar.interfaces.contact_tangent import LinkDerivatives
from dolfinx_mortar.interfaces.coupling import (
    CoupledSides,
    Coupling,
    Pattern,
    Sides,
    create_coupling,
    create_pattern,
    free_directions,
)
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE, Interface
from dolfinx_mortar.interfaces.results import NoResult
from dolfinx_mortar.interfaces.wear import Archard, Wearing
from dolfinx_mortar.mortar.common_normals import common_normals
from dolfinx_mortar.mortar.curvature_correction import find_smooth_sides
from dolfinx_mortar.mortar.duals import Coverage, find_coverage, node_weights
from dolfinx_mortar.mortar.facing_bodies import check_angle
from dolfinx_mortar.mortar.integrals import drop_far, find_segments
from dolfinx_mortar.mortar.operators import create_operators
from dolfinx_mortar.mortar.pairing import Pairing, create_pairing

# Least free part of a node's normal for a multiplier, which may exceed the free force tenfold.
MIN_FREE_NORMAL = 0.1

SURFACES = one_of("smooth", "facets")


class MortarInterface(Interface):
    """A tagged slave and master side, coupled by D and M.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag or name (see `Tags`) of the nonmortar side.
        master: tag or name of the mortar side.
        surface: "facets", or "smooth" for smooth surfaces through the nodes.
        feature_angle: least angle of an edge between facets in degrees.

    Raises:
        ValueError: for invalid arguments.
    """

    def __init__(
        self,
        facet_tags: MeshTags,
        *,
        slave: int | str,
        master: int | str,
        surface: str = "smooth",
        feature_angle: float = FEATURE_ANGLE,
    ) -> None:
        super().__init__(facet_tags, slave=slave)
        self.master = tag_of(facet_tags, master, "master")
        if self.slave == self.master and not self.unilateral:
            raise ValueError(
                f"slave and master are both tag {label(facet_tags, self.slave)}: give two "
                "different tags"
            )
        self.smooth = check("surface", surface, SURFACES) == "smooth"
        self.feature_angle = check_angle(feature_angle)

    def __repr__(self) -> str:
        said = "" if self.smooth else ", surface='facets'"
        if self.smooth and self.feature_angle != FEATURE_ANGLE:
            said = f", feature_angle={self.feature_angle:g}"
        master = label(self.facet_tags, self.master)
        return f"{super().__repr__()[:-1]}, master={master}{said})"

    def given(self) -> dict[str, Any]:
        """See `Interface.given`."""
        return super().given() | {
            "master": self.master,
            "surface": "smooth" if self.smooth else "facets",
            "feature_angle": self.feature_angle,
        }

    def reach(self, sizes: Floats, nearest: float) -> Floats:
        """Largest distances (q,) of paired points, by facet diameters and the least distance."""
        return np.full(len(sizes), np.inf)

    @abstractmethod
    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Nodes (n, c) that may have a multiplier, for c choices of direction.

        Args:
            left: (n,) length of the unit normals without prescribed directions.
            fixed: (n, d) directions with Dirichlet data.
        """

    def pair(
        self,
        sides: Sides,
        u: fem.Function | None,
        *,
        again: bool,
        earlier: tuple[Pairing | None, Pattern] | None = None,
    ) -> tuple[Pairing, Pattern]:
        """See `Interface.pair`; collective."""
        assert sides.master is not None
        known, pattern = (None, None) if earlier is None else earlier
        options = {"again": again, "weight": sides.weight, "earlier": known}
        surfaces = sides.slave, sides.master
        pairing = create_pairing(*surfaces, u, moving=u is not None, **options)
        if known is not None and pattern is not None and pairing.D is known.D:
            return pairing, pattern
        smooth = nearby = None
        if sides.shapes:
            at = pairing, sides.fixed, self.feature_angle
            found = find_smooth_sides(*at, sides.shapes)
            smooth, nearby = (found, None) if self.smooth else (None, found)
        entries = pairing.row, pairing.column, len(pairing.off_diagonal)
        return pairing, create_pattern(sides, *entries, smooth, nearby)

    def find_partners(self, pairing: Pairing, u: fem.Function | None) -> tuple[Segments, Floats]:
        """Coupled segments at X + u, and the slave normals; collective."""
        segments, normals = find_segments(pairing, u)
        if self.within != np.inf:
            segments = drop_far(pairing, segments, u, self.reach)
        return segments, normals

    def measure_coverage(
        self, sides: Sides, pairing: Pairing | None, u: fem.Function | None
    ) -> Coverage:
        """See `Interface.measure_coverage`; collective."""
        assert pairing is not None
        segments, _ = self.find_partners(pairing, u)
        return find_coverage(pairing, segments, *node_weights(pairing, segments))

    def couple(
        self,
        sides: Sides,
        pairing: Pairing | None,
        pattern: Pattern,
        banned: Bools,
        u: fem.Function | None,
    ) -> Coupling:
        """See `Interface.couple`; collective."""
        assert pairing is not None
        comm, slave, own = sides.V.mesh.comm, sides.slave, slice(None, sides.slave.owned)
        segments, averaged = self.find_partners(pairing, u)
        # planes of symmetry continue the side by its image
        normals, _ = free_directions(averaged, sides.mirrors[slave.nodes])
        fixed, free = sides.fixed[slave.nodes], ~banned[slave.nodes, None]
        _, left = free_directions(normals, fixed)
        allowed = self.may_carry(left, fixed) & free
        options = {"heights_of" if self.unilateral else "motions_of": pattern.smooth}
        operators = create_operators(pairing, u, segments, normals, allowed, **options)
        common = None
        if sides.spreads is not None:
            at = pairing, segments, operators.M[:, 0], u, averaged
            common = common_normals(*at, sides.spreads, self.feature_angle)
            normals = common.everywhere(slave)
            _, left = free_directions(normals, fixed)
            may = self.may_carry(left, fixed)
            if any_rank(comm, (operators.kept & ~may[own]).any())[0]:
                allowed &= may
                operators = create_operators(pairing, u, segments, normals, allowed, **options)
        return create_coupling(
            pattern,
            operators.P,
            normals[own],
            fixed[own],
            operators.kept,
            tangential=self.law is not None or not self.unilateral,
            added=operators.motions,
            weight=operators.weight,
            heights=operators.heights,
            coverage=operators.coverage,
            operators=operators,
            common=common,
        )


class Unilateral(Wearing):
    """Bounds w_n <= gap, pressure >= 0, pressure * opening = 0; perhaps with friction."""

    unilateral = True

    def __repr__(self) -> str:
        name = super().__repr__()
        if self.wear is not None:
            name = f"{name[:-1]}, wear=Archard)"
        if self.law is None:
            return name
        value = self.law.value
        said = f"{value:g}" if isinstance(value, float) else ", ".join(self.law.own)
        return f"{name[:-1]}, {self.law.name}={said or type(value).__name__})"

    def given(self) -> dict[str, Any]:
        """See `Interface.given`."""
        names = "friction", "tresca", "offset", "wear"
        return super().given() | {name: getattr(self, name) for name in names}

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Raise a ValueError for Functions on another mesh than V's."""
        given = {"offset": self.offset, "wear: k": None if self.wear is None else self.wear.k}
        given |= {"friction": self.friction, "tresca": self.tresca}
        for name, value in given.items():
            for one in getattr(value, "reads", [value]):
                if isinstance(one, fem.Function):  # Constants need no mesh
                    check_mesh(name, one, V)

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
        return (left >= MIN_FREE_NORMAL)[:, None]

    def derivatives(self, link: CoupledSides) -> LinkDerivatives:
        """See `Interface.derivatives`; collective."""
        return LinkDerivatives(link, self.tool)

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
        friction: Coulomb's coefficient mu: a number, a scalar Constant, a scalar Lagrange Function
            on this mesh, read at every step, or a
            `dolfinx_mortar.interfaces.constraints.Coefficient`, as which a function of pressures
            and slips (n,) is frozen.
        tresca: limit of the tangential traction instead, at every slave node that faces the master;
            a step is then a convex minimisation. In axisymmetry per circumference at X for small
            strains.
        offset: length added to the gap, as friction: g_j + D_jj^-1 int Phi_j o. Positive where
            material was removed from the slave side (wear), negative for a shim or a coating.
        wear: law of wear, `dolfinx_mortar.interfaces.wear.Archard`; further result ``wear_depth``.
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
        offset: Limit | None = None,
        wear: Archard | None = None,
    ) -> None:
        tags = {"slave": slave, "master": master}
        super().__init__(facet_tags, **tags, surface=surface, feature_angle=feature_angle)
        self.law = create_law(friction, tresca)
        self.set_offset(offset, wear)

    @property
    def meets_itself(self) -> bool:
        """Whether slave and master are one surface."""
        return self.slave == self.master
