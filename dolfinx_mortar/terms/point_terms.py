# SPDX-License-Identifier: MIT
"""Terms of one node: a dead force and a spring to the ground."""

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arguments import array, check, instance
from dolfinx_mortar.arrays import HALF_OF_DIGITS, ROUND_OFF, Floats, Ints
from dolfinx_mortar.solid.term import Term


class PointTerm(Term):
    """A term of the displacement of the node at a point."""

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

    def given(self) -> Mapping[str, Any]:
        """Arguments that have to agree on all ranks; see `agreement`."""
        return self._given

    def act_on(self, u: fem.Function) -> None:
        """Bind the displacement of a problem.

        Raises:
            ValueError: if V is not its space, or for a second displacement.
        """
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
        """Displacement (m, d) of the node, m = 1 on its rank and 0 on others."""
        if self._u is None:
            raise ValueError(f"{type(self).__name__}: it acts in a problem: ContactProblem(terms=)")
        return np.asarray(self._u.x.array.reshape(-1, self.V.mesh.geometry.dim)[self._node])

    def _add(self, F: PETSc.Vec, force: Floats) -> None:
        F.array_w.reshape(-1, self.V.mesh.geometry.dim)[self._node] += force


class PointForce(PointTerm):
    """A dead force f on the node at a point: Pi(u) = -f.u(X).

        tip = fem.Constant(mesh, (0.0, -50.0))
        problem = dm.ContactProblem(solid, bcs=bcs, terms=[dm.PointForce(V, (4.0, 1.0), tip)])

    As the mesh is refined stresses below the force diverge, in 2D and 3D also the displacement of
    the node; everything farther away converges. A traction on a small side has no such singularity.

    Args:
        V: space of the displacement.
        point: coordinates (d,) at X of one of its nodes, the same on all ranks.
        value: the force (d,), numbers or a Constant, whose value is read at the start of every
            step; in the plane per thickness, in axisymmetry on the whole ring.

    Raises:
        ValueError: on all ranks, naming a wrong argument, and for a point with no node, or several.
    """

    has_tangent = False

    def __init__(self, V: fem.FunctionSpace, point: Sequence[float] | Floats, value: Any) -> None:
        """Check and find the node; collective."""
        super().__init__(V, point, value=value)
        self._value = value
        self._f = self._read()

    def _read(self) -> Floats:
        """The present force (d,)."""
        constant = isinstance(self._value, fem.Constant)
        d = self.V.mesh.geometry.dim
        remedy = f"give {d} finite components, numbers or a Constant"
        value = self._value.value if constant else self._value
        return check("PointForce: value", value, array((d,), remedy=remedy))

    def begin(self, start: float, end: float) -> None:
        """Read the force."""
        self._f = self._read()

    def energy(self) -> Floats:
        """Addends -f_i u_i of this rank."""
        return np.asarray(-self._f * self._moved).ravel()

    def add_forces(self, F: PETSc.Vec) -> None:
        """Subtract f."""
        self._add(F, -self._f)

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add nothing."""


class PointSpring(PointTerm):
    """A spring from the node at a point to the ground: Pi(u) = 1/2 u(X).k u(X).

    Its force on the node is -k u. A soft spring prevents rigid motions; ``k * outer(n, n)`` acts in
    the direction n alone.

    Args:
        V: space of the displacement.
        point: coordinates (d,) at X of one of its nodes, the same on all ranks.
        stiffness: force per displacement: a number k >= 0 for all directions, or a symmetric,
            positive semidefinite matrix (d, d); in the plane per thickness, in axisymmetry of the
            whole ring.

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

    def energy(self) -> Floats:
        """Addends u_i (k u)_i / 2 of this rank."""
        return np.asarray(0.5 * self._moved * (self._moved @ self._k)).ravel()

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add k u."""
        self._add(F, self._moved @ self._k)

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add k."""
        d = self.V.mesh.geometry.dim
        for node in self.V.dofmap.index_map.local_to_global(self._node):
            rows = (d * node + np.arange(d)).astype(PETSc.IntType)
            K.setValues(rows, rows, self._k, addv=True)


def _is_semidefinite(k: Floats) -> bool:
    """Whether a number or a matrix is symmetric and positive semidefinite, to round-off."""
    k = np.atleast_2d(k)
    error = ROUND_OFF * np.abs(k).max()
    return bool(np.abs(k - k.T).max() <= error and np.linalg.eigvalsh(k)[0] >= -error)


def find_node(V: fem.FunctionSpace, point: Floats, name: str) -> Ints:
    """The node at a point, empty on ranks that do not own it; collective.

    Raises:
        ValueError: on all ranks, unless there is exactly one.
    """
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
