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

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.interfaces.constraints import Constraints, SlipLimits, upper_bounds
from dolfinx_mortar.interfaces.coulomb import FrictionLaw, Limit, create_law
from dolfinx_mortar.interfaces.coupling import CoupledSides, Frame, normal_frames
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE, Interface, NoResult
from dolfinx_mortar.interfaces.mortar_interface import MortarInterface
from dolfinx_mortar.interfaces.nodal import check_mesh
from dolfinx_mortar.mortar.edges import facing_edges
from dolfinx_mortar.mortar.operators import SmoothSides
from dolfinx_mortar.mortar.surface import accumulate, mean_facet_length

# A slave node of whose normal Dirichlet data leave less than this share, at more than 84 degrees,
# carries no multiplier: it would balance the forces in what is left, ten times as large.
MIN_FREE_NORMAL = 0.1


@dataclass(frozen=True)
class SlidingFields:
    """Nodal results of friction as Functions; zero until the first step."""

    traction: fem.Function
    step_slip: fem.Function
    slip: fem.Function
    status: fem.Function
    energy: fem.Function  # dissipated by friction at a node since the start

    @property
    def functions(self) -> list[fem.Function]:
        """All nodal results of friction."""
        return [self.traction, self.step_slip, self.slip, self.status, self.energy]


class Unilateral(Interface):
    """w_n <= gap, pressure >= 0, pressure * opening = 0; perhaps with friction, see `Contact`.

    Attributes:
        law: of friction, None for none.
        sliding: nodal results of friction.
        dissipated: sum of the energies, all ranks.
    """

    unilateral = True
    pressure_name = "contact pressure"
    law: FrictionLaw | None = None
    sliding: SlidingFields | None = None
    dissipated: float = 0.0

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

    def check(self, V: fem.FunctionSpace) -> None:
        """Raise a ValueError for limits of friction on another mesh than V's."""
        if self.law is not None and isinstance(self.law.value, fem.Function):
            check_mesh(self.law.name, self.law.value, V)  # a Constant is a number

    def take(self, owner: object, V: fem.FunctionSpace) -> None:
        """Belong to a problem from now on, with fields on V and without results; collective."""
        super().take(owner, V)
        assert self.fields is not None
        self.sliding, self.dissipated = None, 0.0
        if self.law is not None:
            scalar = self.fields.pressure.function_space
            self.sliding = SlidingFields(
                fem.Function(V, name="traction"),
                fem.Function(V, name="step_slip"),
                fem.Function(scalar, name="slip"),
                fem.Function(scalar, name="status"),
                fem.Function(scalar, name="energy"),
            )

    @property
    def functions(self) -> list[fem.Function]:
        """All nodal results."""
        return super().functions + self.functions_of_friction

    @property
    def functions_of_friction(self) -> list[fem.Function]:
        """Traction, slip of the step, slip, status and energy; none without friction."""
        return [] if self.sliding is None else self.sliding.functions

    def clear(self) -> None:
        """Remove the results, as before the first step; without communication."""
        super().clear()
        self.dissipated = 0.0

    def sum_up(self, comm: MPI.Comm, nodes: Ints) -> None:
        """Add up the dissipation at the owned slave nodes; collective."""
        if self.sliding is not None:
            energy = self.sliding.energy.x.array[nodes]
            self.dissipated = comm.allreduce(float(energy.sum()), op=MPI.SUM)

    def field(self, name: str) -> fem.Function | None:
        """Return a field by the name under which it is written, None if there is none."""
        if self.sliding is not None and name in ("status", "traction", "slip"):
            return getattr(self.sliding, name)
        return super().field(name)

    def keep(self) -> Any:
        """Return copies of the results, for `put_back`."""
        return super().keep(), self.dissipated

    def put_back(self, kept: Any) -> None:
        """Restore what `keep` has returned; without communication."""
        shown, self.dissipated = kept
        super().put_back(shown)

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

    @property
    def rough(self) -> bool:
        """Whether the contact has friction."""
        return self.law is not None

    @property
    def acts_openly(self) -> bool:
        """Whether given friction acts at open nodes, too."""
        return self.law is not None and self.law.name == "tresca"

    def limits(self) -> Floats | None:
        """Return mu or s at the owned nodes, None without friction; collective.

        Raises:
            ValueError: on all ranks, for values that are negative or not finite.
        """
        if self.law is None:
            return None
        assert self.fields is not None
        return self.law.values(self.fields.pressure.function_space)

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

    def constraints(self, nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
        """Return w_n <= gap, the gap being minus the relative position along the normal."""
        return upper_bounds(nodes, directions, slip, D)

    def slip_limits(
        self, nodes: Ints, directions: Bools, frames: Floats, slip: Floats, D: Floats, limit: Floats
    ) -> SlipLimits:
        """Return the limits of tangential reactions.

        Args:
            nodes: (n,) owned slave nodes.
            directions: (n, d) which directions of the frames are constrained.
            frames: (n, d, d) of which rows are the directions.
            slip: (n, d) relative motion since the last commit, in the frames.
            D: (n, c) weights.
            limit: (owned nodes,) mu or s.
        """
        on = directions[:, 0]
        some, d = directions[on, 1:], directions.shape[1]
        normal = (d * nodes[on]).astype(np.int32)
        tangential = np.where(some, normal[:, None] + np.arange(1, d), -1).astype(np.int32)
        values, weight = limit[nodes[on]], D[on, 0]
        coulomb = self.law is not None and self.law.name == "friction"
        return SlipLimits(
            nodes=nodes[on],
            normal=normal,
            tangential=tangential,
            axes=frames[on, 1:],
            slip=np.where(some, slip[on, 1:], 0.0),
            coefficient=values if coulomb else np.zeros_like(values),
            cohesion=np.zeros_like(values) if coulomb else values * weight,
            weight=weight,
            beside=np.zeros((len(values), d)),
            before=np.zeros((len(values), d)),
            room=np.ones_like(values),
            opening=np.zeros((len(values), d)),
        )

    # -- results ---------------------------------------------------------------------------------

    def _of_friction(self, name: str) -> Any:
        if self.law is None:
            raise NoResult(self, name, "it has no friction: give friction= or tresca=")
        return self._result(self.sliding, name)

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

    def gather(self, u: fem.Function) -> Mapping[str, Floats]:
        """Return the slave nodes of all ranks on every rank; collective.

        Returns:
            What `Interface.gather` does; with friction also "traction" (n, d), "step_slip" (n, d),
            "slip" and "status" (n,).
        """
        if self.sliding is None:
            return super().gather(u)
        names = ("traction", "step_slip", "slip", "status")
        return self.gather_functions(u, {name: getattr(self.sliding, name) for name in names})


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
        tags = {"slave": slave, "master": master}
        super().__init__(facet_tags, **tags, surface=surface, feature_angle=feature_angle)
        self.law = create_law(friction, tresca)

    def corrections(self, smooth: SmoothSides) -> dict[str, SmoothSides]:
        """Return the argument by which heights of smooth surfaces correct the gap."""
        return {"heights_of": smooth}

    def in_corners(self, link: CoupledSides, x: PETSc.Vec) -> str:
        """Say where an edge or a corner of the master presses on slave facets; collective.

        The gap there is a mean over both of its flanks, and changes by their slopes where it moves
        along the side, with and without friction. Near are gaps of at most a facet.
        """
        if self.meets_itself:  # which part is the slave is not for the user to say
            return ""
        pairing, operators = link.mortar
        slave, comm = link.sides.slave, link.sides.V.mesh.comm
        near, length = np.zeros(len(slave.nodes)), mean_facet_length(slave)
        near[: slave.owned] = link.coupling.kept[:, 0] & (np.abs(link.gaps(x)) <= length)
        faced = facing_edges(pairing, operators.segments, self.feature_angle)
        found = faced & (accumulate(slave, near) > 0)[slave.facets].any(axis=1)
        where = first_place(comm, slave.X[slave.facets[found]].mean(axis=1), length)
        if not where:
            return ""
        return (
            f"{self!r}: around X = ({where}) an edge or a corner of the master lies at facets of "
            "the slave side, over which its gap is a mean, so that Newton's method need not "
            "converge, not even in small steps: exchange slave and master, or refine the slave "
            "there"
        )


def first_place(comm: MPI.Comm, places: Floats, length: float) -> str:
    """Return the coordinates of the first of places (p, d) of all ranks, "" if there is none.

    What is round-off of the length is zero; collective.
    """
    told = [place for part in comm.allgather(places[:1].tolist()) for place in part][:1]
    least = HALF_OF_DIGITS * length
    return ", ".join(f"{c if abs(c) > least else 0.0:.3g}" for place in told for c in place)
