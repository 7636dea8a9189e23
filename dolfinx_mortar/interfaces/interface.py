# SPDX-License-Identifier: MIT
"""Interfaces between bodies as their user describes them, and their results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.arguments import is_number
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.constraints import Constraints
from dolfinx_mortar.mortar.surface import check_tags
from dolfinx_mortar.tags import check_tag, label, tag_of


class NoResult(RuntimeError, AttributeError):
    """A result was asked for before the first step; also an AttributeError, for ``hasattr``."""

    def __init__(self, interface: Interface, name: str, why: str = "") -> None:
        """Say what is missing, and what to do."""
        why = f": {why}" if why else " yet: solve a step first, newton(problem)"
        super().__init__(f"{interface} has no {name}{why}")


@dataclass(frozen=True)
class Frame:
    """Directions at the owned slave nodes, and which of them an interface constrains."""

    R: Floats  # (n, d, d) orthonormal, the columns are the directions
    slot: Ints  # (n, d) column of R that is a prescribed Cartesian direction, else -1
    directions: Bools  # (n, d) columns of R that are constrained
    normals: Floats  # (n, d)


@dataclass(frozen=True)
class Fields:
    """Nodal results as Functions; zero until the first step."""

    pressure: fem.Function
    gap: fem.Function
    active: fem.Function


@dataclass(frozen=True)
class Resultants:
    """Results of a step that are no Functions."""

    force: Floats  # (d,) resultant exerted on the slave side
    moment: Floats  # (3,) its moment about the origin
    master_force: Floats  # (d,) the same for the master side
    master_moment: Floats  # (3,)
    multiplier: Floats  # (n,) or (n, d) lambda_j = reaction_j / D_jj at the owned slave nodes
    nodes: Ints  # (n,) local numbers of these nodes
    carries: Bools  # (n,) which of them have a multiplier


SURFACES = ("smooth", "facets")
# Facets whose normals differ by more degrees meet in an edge, unless the user says otherwise.
FEATURE_ANGLE = 40.0


class Interface:
    """One pair of slave and master surfaces, marked in facet tags.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag, or name if the tags have names (see `Tags`), of the side that carries the
            multipliers and the integration (nonmortar side).
        master: tag or name of the other side (mortar side).
        surface: "facets", or "smooth" where they stand for smooth surfaces.
        feature_angle: degrees between two facets from which on they meet in an edge, which stays
            one; for smooth surfaces.

    Raises:
        ValueError: for tags that are none, unknown names, and an unknown surface or angle.

    After a step (see the subclasses for signs): ``force``, ``moment``, ``pressure``, ``gap`` and
    ``active``.
    """

    one_sided: ClassVar[bool] = False  # can open: bounds on one side

    @property
    def rough(self) -> bool:
        """Whether it has friction."""
        return False

    @property
    def acts_openly(self) -> bool:
        """Whether it acts at slave nodes that are not closed, too."""
        return not self.one_sided

    def __init__(
        self,
        facet_tags: MeshTags,
        *,
        slave: int | str,
        master: int | str,
        surface: str = "smooth",
        feature_angle: float = FEATURE_ANGLE,
    ) -> None:
        """Keep the description; surfaces are found when a problem takes the interface."""
        check_tags(facet_tags)
        self.slave: int = tag_of(facet_tags, slave, "slave")
        self.master: int = tag_of(facet_tags, master, "master")
        for name, tag in (("slave", self.slave), ("master", self.master)):
            check_tag(name, tag)
        if self.slave == self.master:
            raise ValueError(
                f"slave and master are both tag {label(facet_tags, self.slave)}: give two "
                "different tags"
            )
        if not isinstance(surface, str) or surface not in SURFACES:
            raise ValueError(f"surface is {surface!r}: choose 'smooth' or 'facets'")
        if not is_number(feature_angle) or not 0.0 < feature_angle <= 180.0:
            raise ValueError(
                f"feature_angle is {feature_angle!r}: give degrees, 0 < feature_angle <= 180"
            )
        self.smooth, self.feature_angle = surface == "smooth", float(feature_angle)
        self.facet_tags = facet_tags
        self.owner: object = None  # the problem that has taken the interface
        self.fields: Fields | None = None
        self.resultants: Resultants | None = None

    def __repr__(self) -> str:
        """Name the class, the tags, and what is not the default."""
        said = "" if self.smooth else ", surface='facets'"
        if self.smooth and self.feature_angle != FEATURE_ANGLE:
            said = f", feature_angle={self.feature_angle:g}"
        return f"{type(self).__name__}({self.sides}{said})"

    @property
    def sides(self) -> str:
        """How messages call the two sides."""
        slave, master = (label(self.facet_tags, tag) for tag in (self.slave, self.master))
        return f"slave={slave}, master={master}"

    def given(self) -> dict[str, Any]:
        """Return what all ranks have to give the same, by name; see `agreement`."""
        return {
            "facet_tags": self.facet_tags,
            "slave": self.slave,
            "master": self.master,
            "surface": "smooth" if self.smooth else "facets",
            "feature_angle": self.feature_angle,
        }

    def check(self, V: fem.FunctionSpace) -> None:
        """Raise a ValueError unless a problem with the displacement's space can take it."""

    def take(self, owner: object, V: fem.FunctionSpace) -> None:
        """Belong to a problem from now on, with fields on V and without results; collective."""
        scalar = V.sub(0).collapse()[0]
        self.owner, self.resultants = owner, None
        self.fields = Fields(
            *(fem.Function(scalar, name=name) for name in ("pressure", "gap", "active"))
        )

    # -- what a kind decides ---------------------------------------------------------------------

    def configuration(self, u: fem.Function | None) -> fem.Function | None:
        """Return the displacement at which the interface is taken, None for X."""
        return u

    @property
    def released(self) -> tuple[float, ...] | None:
        """Direction along which sides overlap under a given force; None where there is none."""
        return None

    def reach(self, sizes: Floats, nearest: float) -> Floats:
        """Return how far apart (q,) partners may be; contacts meet from any distance.

        Args:
            sizes: (q,) diameter of the larger one of two facets.
            nearest: least distance between the sides.
        """
        return np.full(len(sizes), np.inf)

    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Return (n, c): which nodes may carry a multiplier, for each of c choices of direction.

        Args:
            left: (n,) length of the unit normals without prescribed directions.
            fixed: (n, d) directions with Dirichlet data.
        """
        raise NotImplementedError

    def frame(self, normals: Floats, kept: Bools, fixed: Bools) -> Frame:
        """Return the frames for unit normals (n, d), kept nodes (n, c), Dirichlet data (n, d)."""
        raise NotImplementedError

    def blocks(self, P: Floats, frame: Frame, row: Ints) -> Floats:
        """Return the entries (e, d, d) of Q for P (e, c) in rows (e,) of the frame."""
        raise NotImplementedError

    def measured(self, x: PETSc.Vec, u: PETSc.Vec) -> PETSc.Vec:
        """Return what the constraints speak of: positions x or displacements u."""
        raise NotImplementedError

    def constraints(self, nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
        """Return the bounds on further motion.

        Args:
            nodes: (n,) owned slave nodes.
            directions: (n, d) which directions of the frames are constrained.
            slip: (n, d) relative motion of what is ``measured``, in the frames.
            D: (n, c) weights.
        """
        raise NotImplementedError

    # -- results ---------------------------------------------------------------------------------

    @property
    def functions(self) -> list[fem.Function]:
        """All nodal results, of an interface that a problem has taken."""
        assert self.fields is not None
        return [self.fields.pressure, self.fields.gap, self.fields.active]

    def keep(self) -> Any:
        """Return copies of the results, for `put_back`."""
        return self.resultants, [(f, f.x.array.copy()) for f in self.functions]

    def put_back(self, kept: Any) -> None:
        """Show what `keep` has returned; without communication."""
        self.resultants, functions = kept
        for f, values in functions:
            f.x.array[:] = values

    def _result(self, record: Any, name: str) -> Any:
        if record is None:
            raise NoResult(self, name)
        return getattr(record, name)

    @property
    def force(self) -> Floats:
        """Resultant (d,) exerted on the slave side.

        Of rings, (radial, axial): the sum of what pushes outwards all around, which no force on
        the whole balances, and the force along the axis.
        """
        return self._result(self.resultants, "force")

    @property
    def moment(self) -> Floats:
        """Moment (3,) about the origin of the forces on the slave side.

        Of rings that of these sums in the plane of the section: it tells whether the two sides
        balance, and is no moment on the whole, which is zero.
        """
        return self._result(self.resultants, "moment")

    @property
    def master_force(self) -> Floats:
        """Resultant (d,) exerted on the master side."""
        return self._result(self.resultants, "master_force")

    @property
    def master_moment(self) -> Floats:
        """Moment (3,) about the origin of the forces on the master side."""
        return self._result(self.resultants, "master_moment")

    @property
    def multiplier(self) -> Floats:
        """Multipliers lambda_j at the owned slave nodes."""
        return self._result(self.resultants, "multiplier")

    @property
    def pressure(self) -> fem.Function:
        """Normal traction, positive in compression; zero off the slave side."""
        return self._result(self.fields, "pressure")

    @property
    def gap(self) -> fem.Function:
        """Distance to the master; zero off the slave side."""
        return self._result(self.fields, "gap")

    @property
    def active(self) -> fem.Function:
        """1 where the interface acts, else 0."""
        return self._result(self.fields, "active")

    def gather(self, u: fem.Function) -> Mapping[str, Floats]:
        """Return the slave nodes of all ranks on every rank; collective.

        Returns:
            "X" (n, d) reference and "x" (n, d) current coordinates at u, "pressure", "gap" and
            "active" (n,), ordered by X.

        Raises:
            NoResult: before the first step.
            ValueError: for what is no displacement.
        """
        return self.gather_functions(u, {})

    def gather_functions(
        self, u: fem.Function, more: Mapping[str, fem.Function]
    ) -> Mapping[str, Floats]:
        """Return the same with more Functions; collective."""
        if self.resultants is None or self.fields is None:
            raise NoResult(self, "nodal results")
        mesh = self.fields.pressure.function_space.mesh
        if not isinstance(u, fem.Function) or u.function_space.mesh is not mesh or not u.ufl_shape:
            raise ValueError(f"u is {u!r}: give the displacement, solid.u")
        V, own, d = u.function_space, self.resultants.nodes, len(self.force)
        X = V.tabulate_dof_coordinates()[own, :d]
        functions = {name: getattr(self.fields, name) for name in ("pressure", "gap", "active")}
        functions |= more
        sizes = {name: f.function_space.dofmap.index_map_bs for name, f in functions.items()}
        columns = [X, X + u.x.array.reshape(-1, d)[own]]
        columns += [f.x.array.reshape(-1, sizes[name])[own] for name, f in functions.items()]
        table = np.concatenate(V.mesh.comm.allgather(np.hstack(columns)))
        table = table[np.lexsort(table[:, :d].T[::-1])]
        ends = np.cumsum([d, d, *sizes.values()])[:-1]
        parts = dict(zip(("X", "x", *sizes), np.split(table, ends, axis=1), strict=True))
        return {
            name: part if sizes.get(name, d) > 1 else part[:, 0] for name, part in parts.items()
        }


def check_owned(interfaces: Iterable[Interface], owner: object) -> None:
    """Raise a ValueError if a problem made later has taken over an interface.

    Args:
        interfaces: those of the problem.
        owner: what the problem has taken them for.
    """
    for interface in interfaces:
        if interface.owner is not owner:
            raise ValueError(
                f"interfaces: {interface} belongs to a problem made later, whose results it shows; "
                f"give each its own {type(interface).__name__}"
            )
