# SPDX-License-Identifier: MIT
"""Loads: follower pressure; dead force and spring of a node."""

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import Mesh, MeshTags
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import FLAG, Rule, array, check, instance, is_number
from dolfinx_mortar.common.arrays import (
    HALF_OF_DIGITS,
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    Bools,
    Floats,
    Ints,
)
from dolfinx_mortar.common.tags import check_entities, find_exterior, in_order, tag_of, tags_of
from dolfinx_mortar.solid.laws import measure
from dolfinx_mortar.solid.mean_volume import CellFunctions
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.term import Term, assemble
from dolfinx_mortar.terms.weak_forms import WeakForm, weighted
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr


class Pressure(WeakForm):
    """A follower pressure p: the traction -p n per present area of the deformed surface.

    By Nanson's formula, with F = I + grad u and the normal N at X,

        F_i = int p (cof F N) . phi_i dS,    cof F = det F F^-T.

    Its tangent is the symmetric part of dF/du. dF/du is symmetric on a closed surface, or if the
    edges of the surface are fixed or slide in planes through the origin: p then has the potential p
    V, V the enclosed volume, and Newton's method is quadratic, with a line search. Otherwise whole
    steps converge linearly, at a rate of about p over the moduli, except with the exact tangent of
    closed contacts. For dead loads see ``loads`` of the problem.

    In plane stress cof F has the factor of the stretch through the thickness, extrapolated from the
    adjacent cell; the tangent omits its derivative.

    Args:
        solid: the bodies, with ``strain="finite"``.
        tag: a tag or its name, of exterior facets.
        p: pressure, positive into the body: a number, or a Constant, a Function or UFL, whose
            values may change between steps.
        closed: whether it has the potential p V; not in plane stress.

    Raises:
        ValueError: naming a wrong argument; at the start of a step, for a p that is NaN or
            infinite.
    """

    def __init__(
        self, solid: Solid, facet_tags: MeshTags, tag: int | str, p: Any, *, closed: bool = False
    ) -> None:
        """Check and compile; collective."""
        if not isinstance(solid, Solid) or solid.strain != "finite":
            raise ValueError(
                "Pressure: solid must be a Solid(.., strain='finite'); at small strain give the "
                "traction -p n as loads=inner(-p * n, v) * ds"
            )
        domain = solid.mesh
        given = {"facet_tags": facet_tags, "tag": tag, "p": p, "closed": closed}
        check_same_on_all_ranks(domain.comm, **given)
        facet_tags, number = _exterior(domain, facet_tags, tag)
        p = fem.Constant(domain, default_scalar_type(p)) if is_number(p) else p
        scalar = isinstance(p, Expr) and p.ufl_shape == () and not extract_arguments(p)
        remedy = "give a number, or a scalar Constant or UFL without a test function"
        p = check("Pressure: p", p, Rule(remedy, lambda p: p if scalar else None))
        if check("Pressure: closed", closed, FLAG) and solid.kinematics.plane_stress:
            raise ValueError(
                "Pressure: closed is True, but in plane stress the edge of a plate changes its "
                "thickness, and a pressure on it has no potential: leave closed out"
            )
        u, d = solid.u, domain.geometry.dim
        self._thickness = _Thickness(solid) if solid.kinematics.plane_stress else None
        ds = ufl.Measure("ds", domain, subdomain_data=facet_tags)(number)
        F = solid.kinematics.measure(u)
        cofactor = ufl.det(F) * ufl.transpose(ufl.inv(F))
        N = ufl.FacetNormal(domain)
        area = [sum(cofactor[i, j] * N[j] for j in range(d)) for i in range(d)]  # n da / dS
        traction = p * ufl.as_vector(area)
        if self._thickness is not None:
            traction *= self._thickness.stretch
        super().__init__(solid, residual=ufl.inner(traction, ufl.TestFunction(solid.V)) * ds)
        self._volume: ufl.Form | None = None  # times p
        if closed:
            place = ufl.SpatialCoordinate(domain) + u
            share = 2 if solid.kinematics.radius is None and d == 2 else 3  # div x
            self._volume = weighted(ufl.inner(traction, place) / share * ds, solid)
            self._energy = fem.form(self._volume)
            self._asymmetric = None

    def _update(self) -> None:
        if self._thickness is not None:
            self._thickness.follow()

    def has_potential(self, free: Bools) -> bool:
        """Whether p V is a potential of forces on `free` (owned nodes, d); collective."""
        if self._volume is None:
            return False
        V = self.u.function_space
        slope = fem.form(ufl.derivative(self._volume, self.u, ufl.TestFunction(V)))
        forces = assemble(self._forces, self._vector).copy()
        off = (assemble(slope, self._vector) - forces)[free.ravel()]
        # scaled by all forces: those of free nodes may be 0
        largest = (np.abs(values).max(initial=0.0) for values in (off, forces))
        error, size = maximum(V.mesh.comm, *largest)
        return bool(error <= QUARTER_OF_DIGITS * size)


def _exterior(domain: Mesh, facet_tags: Any, tag: Any) -> tuple[MeshTags, int]:
    check("Pressure: facet_tags", facet_tags, tags_of(domain, domain.topology.dim - 1))
    domain.topology.create_entities(facet_tags.dim)
    with raised_together(domain.comm):
        check_entities("facet_tags", facet_tags)
    number = tag_of(facet_tags, tag, "tag")
    facet_tags = in_order(facet_tags)
    sizes = np.array([len(found) for found in find_exterior(facet_tags, number, domain)])
    marked, outside = domain.comm.allreduce(sizes)
    if not marked:
        raise ValueError(f"Pressure: tag is {tag!r}, which no facet has")
    if outside < marked:
        raise ValueError(
            f"Pressure: tag is {tag!r}, which {marked - outside} facets inside the mesh have, "
            "where no pressure acts: tag exterior facets only"
        )
    return facet_tags, int(number)


class _Thickness:
    """Stretch through the thickness in plane stress, on edges."""

    def __init__(self, solid: Solid) -> None:
        """Compile its projection onto linear functions of cells; collective."""
        assert solid.volumes is not None
        dx = measure(solid.mesh, solid.quadrature_degree)
        # linear functions take three points per cell
        affine = solid.fields.weights.shape[1] > solid.mesh.geometry.dim
        self._cells = CellFunctions(solid.mesh, ufl.as_ufl(1.0), dx, affine=affine)
        self._tested = fem.form(self._cells.tested(solid.volumes.thickness) * dx)
        self._coefficients = fem.Function(self._cells.space)
        self._solid = solid
        self.stretch = self._cells.field(self._coefficients)

    def follow(self) -> None:
        """Update to the stretches at the present u; collective."""
        self._solid.follow()
        found = self._cells.coefficients(self._cells.vectors(self._tested))
        self._cells.values(self._coefficients)[:] = found
        self._coefficients.x.scatter_forward()


class PointTerm(Term):
    """The energy u.k u / 2 - f.u of the node at a point."""

    linear = True

    def __init__(self, V: fem.FunctionSpace, point: Any, **given: Any) -> None:
        """Find the node; collective."""
        name = type(self).__name__
        remedy = "give the space of the displacement, solid.V"
        check(f"{name}: V", V, instance(fem.FunctionSpace, remedy))
        check_same_on_all_ranks(V.mesh.comm, point=point, **given)
        d = V.mesh.geometry.dim
        place = check(f"{name}: point", point, array((d,)))
        if V.dofmap.index_map_bs != d:
            raise ValueError(f"{name}: V has no displacement of {d} components: give solid.V")
        self.V = V
        self._given = {"point": point, **given}
        self._node = find_node(V, place, name)
        self._u: fem.Function | None = None
        self._k, self._f = np.zeros((d, d)), np.zeros(d)

    def given(self) -> Mapping[str, Any]:
        """Arguments that must agree on all ranks, see `agreement`."""
        return self._given

    def act_on(self, u: fem.Function) -> None:
        """Bind the displacement, once; a ValueError unless its space is V."""
        if u.function_space != self.V:
            raise ValueError(f"{type(self).__name__}: V is not the space of solid.u: give solid.V")
        if self._u is not None and self._u is not u:
            raise ValueError(
                f"{type(self).__name__}: it acts on the displacement of another problem: make one "
                "for each"
            )
        self._u = u

    @property
    def _moved(self) -> Floats:
        """Displacement (m, d) of the node, m = 1 on its rank, else 0."""
        if self._u is None:
            raise ValueError(f"{type(self).__name__}: it acts in a problem: ContactProblem(terms=)")
        return self._u.x.array.reshape(-1, self.V.mesh.geometry.dim)[self._node]

    def energy(self) -> Floats:
        """Addends of this rank."""
        return np.asarray((0.5 * self._moved @ self._k - self._f) * self._moved).ravel()

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add k u - f."""
        forces = self._moved @ self._k - self._f
        F.array_w.reshape(-1, self.V.mesh.geometry.dim)[self._node] += forces

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add k."""
        d = self.V.mesh.geometry.dim
        for node in self.V.dofmap.index_map.local_to_global(self._node):
            rows = (d * node + np.arange(d)).astype(PETSc.IntType)
            K.setValues(rows, rows, self._k, addv=True)


class PointForce(PointTerm):
    """A dead force f on the node at a point: Pi(u) = -f.u(X).

        tip = fem.Constant(mesh, (0.0, -50.0))
        problem = dm.ContactProblem(solid, bcs=bcs, terms=[dm.PointForce(V, (4.0, 1.0), tip)])

    Stresses and the displacement of the node diverge as the mesh is refined; a traction on a small
    side has no such singularity.

    Args:
        V: space of the displacement.
        point: coordinates (d,) at X of one of its nodes, the same on all ranks.
        value: the force (d,), numbers or a Constant, read at the start of every step; in the plane
            per thickness, in axisymmetry on the whole ring.

    Raises:
        ValueError: on all ranks, naming a wrong argument, and for a point with no node, or several.
    """

    has_tangent = False

    def __init__(self, V: fem.FunctionSpace, point: Sequence[float] | Floats, value: Any) -> None:
        """Check and find the node; collective."""
        super().__init__(V, point, value=value)
        self._value = value
        self.begin(0.0, 0.0)

    def begin(self, start: float, end: float) -> None:
        """Read the force."""
        d = self.V.mesh.geometry.dim
        remedy = f"give {d} finite components, numbers or a Constant"
        value = self._value.value if isinstance(self._value, fem.Constant) else self._value
        self._f = check("PointForce: value", value, array((d,), remedy=remedy))


class PointSpring(PointTerm):
    """A spring from the node at a point to the ground: Pi(u) = 1/2 u(X).k u(X).

    Its force on the node is -k u. A soft spring prevents rigid motions; ``k * outer(n, n)`` acts
    along n alone.

    Args:
        V: space of the displacement.
        point: coordinates (d,) at X of one of its nodes, the same on all ranks.
        stiffness: force per displacement: a number k >= 0, or a symmetric, positive semidefinite
            matrix (d, d); in the plane per thickness, in axisymmetry of the whole ring.

    Raises:
        ValueError: on all ranks, for a point as in `PointForce`, and other stiffnesses.
    """

    def __init__(
        self, V: fem.FunctionSpace, point: Sequence[float] | Floats, stiffness: Any
    ) -> None:
        """Check and find the node; collective."""
        super().__init__(V, point, stiffness=stiffness)
        d = V.mesh.geometry.dim
        remedy = f"give a number k >= 0, or a matrix {d} x {d}, symmetric and positive semidefinite"
        rule = array((), (d, d), remedy=remedy, holds=_is_semidefinite)
        k = check("PointSpring: stiffness", stiffness, rule)
        self._k = k if k.ndim else k * np.eye(d)

    def varies(self, K: PETSc.Mat) -> bool:
        """False: the stiffness is constant."""
        return False


def _is_semidefinite(k: Floats) -> bool:
    k = np.atleast_2d(k)
    error = ROUND_OFF * np.abs(k).max()
    return bool(np.abs(k - k.T).max() <= error and np.linalg.eigvalsh(k)[0] >= -error)


def find_node(V: fem.FunctionSpace, point: Floats, name: str) -> Ints:
    """The node at a point, or a ValueError; empty on ranks that do not own it; collective."""
    comm, n = V.mesh.comm, V.dofmap.index_map.size_local
    X = V.tabulate_dof_coordinates()[:n, : len(point)]
    distance = np.linalg.norm(X - point, axis=1)
    nearest = comm.allgather((distance.min(initial=np.inf), X[distance.argmin()] if n else None))
    ends = maximum(comm, *np.hstack([X, -X]).max(axis=0, initial=-np.inf)).reshape(2, -1)
    size = float(ends.sum(axis=0).max())
    found = np.flatnonzero(distance <= HALF_OF_DIGITS * size).astype(np.int32)
    count = comm.allreduce(len(found), op=MPI.SUM)
    if count == 0:
        away, place = min(nearest, key=lambda pair: pair[0])
        told = ", ".join(f"{x:.10g}" for x in size * np.round(place / size, 12) + 0.0)
        raise ValueError(
            f"{name}: point {point.tolist()} is no node; the nearest one is ({told}), {away:.3g} "
            "away: give that, or make the mesh have a node there"
        )
    if count > 1:
        raise ValueError(
            f"{name}: {count} bodies have a node at the point {point.tolist()}: give one where "
            "they do not touch, or a traction on a side of the body that is meant"
        )
    return found
