# SPDX-License-Identifier: MIT
"""A load step of bodies, interfaces, supports and loads as a bound-constrained QP in y, u = T y."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem, la
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.basis import Transformation
from dolfinx_mortar.interfaces.claims import resolve_claims
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.results import merge_results
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.qp import MULTIGRID, BoundQP, LinearSolver
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.steps import near
from dolfinx_mortar.steps.audit import Audit, create_audit
from dolfinx_mortar.steps.bodies import Bodies, find_bodies
from dolfinx_mortar.steps.checks import check_arguments, check_owned
from dolfinx_mortar.steps.dirichlet import prescribed_dofs, prescribed_values
from dolfinx_mortar.steps.preconditioning import create_preconditioning
from dolfinx_mortar.steps.report import Timings


class ContactProblem:
    """Elasto-plastic bodies with contact and mesh tying under Dirichlet data and loads.

    One step minimises J(v) = Psi(v) - f.v over B_E v = c_E, B_I v <= c_I (paper, eqs. 2-4).

    Args:
        solid: the bodies: displacement, materials, committed state.
        interfaces: contacts and ties; none is plain elasto-plasticity. A slave node claimed twice
            belongs to the interface that comes first.
        bcs: Dirichlet conditions on the space of ``solid.u`` or its components; their values are
            read anew at every step.
        loads: linear form of the external virtual work, assembled anew at every step.
        geometry: "updated" rebuilds normals, segments, D, M and gaps from X + u in every Newton
            iteration, "reference" freezes them at X.
        petsc_options_prefix: prefix of the linear solver's PETSc options.
        petsc_options: options of the linear solver, without the prefix. PETSc ignores keys that it
            does not know; ``report.linear_solver`` names the method that they have led to.

    Raises:
        ValueError: for arguments that cannot work, on all ranks, with the remedy.
    """

    def __init__(
        self,
        solid: Solid,
        interfaces: Sequence[Interface] = (),
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        loads: ufl.Form | None = None,
        geometry: str = "updated",
        petsc_options_prefix: str = "dolfinx_mortar_",
        petsc_options: Mapping[str, Any] | None = None,
    ) -> None:
        """Check the arguments and create everything that later steps refill."""
        self.interfaces, self.bcs = check_arguments(solid, interfaces, bcs, loads, geometry)
        self.solid, self.u, self.V = solid, solid.u, solid.V
        self.geometry = geometry
        self.timings = Timings()
        layout = self.V.dofmap.index_map
        self.comm, self.d = self.V.mesh.comm, self.V.dofmap.index_map_bs
        self.n = layout.size_local  # owned nodes
        self.first_dof = self.d * layout.local_range[0]
        self.X = self.V.tabulate_dof_coordinates()[: self.n, : self.d].copy()
        self.loads = None if loads is None else fem.form(loads)
        self.fixed = prescribed_dofs(self.V, self.bcs)
        with self.timings("setup"):
            self.K = solid.create_matrix()
            names = ("f", "F", "r", "x", "du", "dy", "lower", "upper")
            self.vectors = {name: self.K.createVecRight() for name in names}
            self.increment = fem.Function(self.V, name="increment")
            self.linear = LinearSolver(
                self.comm,
                prefix=petsc_options_prefix,
                options=(MULTIGRID if self.d == 3 else {}) | dict(petsc_options or {}),
                preconditioning=lambda held: create_preconditioning(self, held),
            )
        with self.timings("mortar"):
            for interface in self.interfaces:
                interface.bind(self.V, self.fixed)
        self.bodies: Bodies = find_bodies(self.V)
        self.active = np.zeros(self.n, dtype=bool)  # of the last QP, owned nodes
        self.notes: list[str] = []
        self.searches = 0
        self.facet_length = 1.0
        self._outputs: dict[str, fem.Function] = {}
        self.target = np.zeros(self.d * self.n)
        self.transformation: Transformation | None = None
        self.outdated = False  # the surfaces were paired anew without a new T
        self._audited: Audit | None = None

    @property
    def contacts(self) -> list[Contact]:
        """The unilateral interfaces."""
        return [i for i in self.interfaces if isinstance(i, Contact)]

    @property
    def ties(self) -> list[Tie]:
        """The tied interfaces."""
        return [i for i in self.interfaces if isinstance(i, Tie)]

    # -- a step ----------------------------------------------------------------------------------

    def audit(self) -> Audit:
        """Return the geometry audit, made before the first step; collective.

        Raises:
            ValueError: if nothing holds a body, or a pair of surfaces cannot meet.
        """
        if self._audited is None:
            self.update_geometry(search=True, at=near.expected_displacement(self))
            self._audited = create_audit(self)
        return self._audited

    def begin_step(self) -> None:
        """Read loads and Dirichlet values of the step; collective.

        Raises:
            ValueError: on NaN or infinity in either, or in the displacement or the coordinates,
                and if another problem has taken over an interface.
        """
        check_owned(self.interfaces, self.fixed)
        f = self.vectors["f"]
        f.set(0.0)
        if self.loads is not None:
            with self.timings("assembly"):
                assembled = fem.assemble_vector(self.loads)
                assembled.scatter_reverse(la.InsertMode.add)
                f.array[:] = assembled.array[: self.d * self.n]
        self.target = prescribed_values(self.V, self.bcs)
        owned = self.fixed.ravel()[: self.d * self.n]
        for name, array, remedy in (
            ("loads", f.array_r, "check the coefficients of the linear form"),
            ("bcs", self.target[owned], "check the values of the conditions"),
            ("u", self.u.x.array, "start from a finite displacement"),
            ("the mesh's coordinates", self.V.mesh.geometry.x, "check the mesh"),
        ):
            bad = self.comm.allreduce(int(np.sum(~np.isfinite(array))), op=MPI.SUM)
            if bad:
                raise ValueError(f"{name}: {bad} values are NaN or infinite; {remedy}")
        if self._audited is None:
            self.audit()
        else:  # u may have been set, or put back after a failed step; new data may reach further
            self.update_geometry(
                search=self.outdated, everywhere=True, at=near.expected_displacement(self)
            )

    def dirichlet_increment(self) -> Floats:
        """Return prescribed minus present values, (owned nodes, d), 0 where free."""
        own = slice(None, self.d * self.n)
        difference = (self.target - self.u.x.array[own]).reshape(-1, self.d)
        return np.where(self.fixed[: self.n], difference, 0.0)

    def changes_dirichlet(self) -> bool:
        """Tell whether prescribed values differ from the present displacement; collective."""
        change = float(np.abs(self.dirichlet_increment()).max(initial=0.0))
        size = float(np.abs(self.u.x.array).max(initial=0.0))
        change, size = maximum(self.comm, change, size)
        return bool(change > 1e-14 * size)

    def prescribed(self, v: PETSc.Vec) -> Floats:
        """Return the components of a displacement that Dirichlet data prescribe."""
        return np.asarray(v.array_r[self.fixed[: self.n].ravel()])

    # -- geometry and constraints ----------------------------------------------------------------

    def update_geometry(
        self, *, search: bool = False, everywhere: bool = False, at: fem.Function | None = None
    ) -> None:
        """Rebuild D, M, N, T at X + u (at X if frozen); collective.

        Args:
            search: pair the surfaces anew in any case; otherwise where they slid too far.
            everywhere: ask so for the whole surfaces, not only near the contact.
            at: displacement instead of u.
        """
        if not self.interfaces:
            self._locate_constraints()
            return
        at = self.configuration if at is None else at
        with self.timings("mortar"):
            if search or self._slid(at, everywhere=everywhere):
                self._search(at)
            for interface in self.interfaces:
                interface.update(interface.configuration(at))
            if self.transformation is None or not near.covers_contact(self):
                near.restrict(self)
                self.linear.release()  # before the new product needs the memory
                self.transformation = Transformation(self.V, self.interfaces, self.order)
            self.transformation.update()
            self._locate_constraints()

    @property
    def configuration(self) -> fem.Function | None:
        """The displacement at which normals and segments are taken."""
        return self.u if self.geometry == "updated" else None

    def _slid(self, at: fem.Function | None, *, everywhere: bool) -> bool:
        """Tell whether contacts slid out of the margins of their pairings; collective."""
        slid = [c.needs_search(at, everywhere=everywhere) for c in self.contacts if at is not None]
        return any(slid)

    def _search(self, at: fem.Function | None) -> None:
        """Pair the surfaces; T has to be built anew; collective."""
        self.searches += 1
        self.outdated = False
        for interface in self.interfaces:
            interface.search(interface.configuration(at))
        self.facet_length = max(i.facet_length for i in self.interfaces)
        self.order, notes = resolve_claims(self.interfaces)
        self.notes += [note for note in notes if note not in self.notes]
        self.transformation = None

    def far_nodes_stay_open(self) -> bool:
        """Tell whether no slave node outside T has come into contact; repairs T if one has."""
        if not self.contacts:
            return True
        with self.timings("mortar"):
            if self._slid(self.configuration, everywhere=True):
                self.outdated = True  # T still fits near the contact; the next step gets a new one
                for contact in self.contacts:
                    contact.search(self.configuration)
                    contact.update(self.configuration)
            open_ = not near.touches_far_nodes(self)
        if not open_:
            self.update_geometry(search=self.outdated)
        return open_

    def _locate_constraints(self) -> None:
        """Set, over owned unknowns of y: slots of Dirichlet data, tied and bounded unknowns."""
        slot = np.tile(np.arange(self.d), (self.n, 1))
        tied = np.zeros((self.n, self.d), dtype=bool)
        bounded = np.zeros(self.n, dtype=bool)
        for interface in self.interfaces:
            nodes, kept = interface.pattern.nodes, interface.S.any(axis=1)
            present = interface.slot[kept] >= 0
            slot[nodes[kept]] = np.where(present, interface.slot[kept], slot[nodes[kept]])
            if isinstance(interface, Tie):
                tied[nodes] |= interface.S
            else:
                bounded[nodes] |= interface.S[:, 0]
        node, component = np.nonzero(self.fixed[: self.n])
        self.dirichlet_dofs = self.d * node + component  # in u
        dirichlet = self.d * node + slot[node, component]  # in y
        self.tied_dofs = np.flatnonzero(tied.ravel())
        self.eliminated = np.concatenate([dirichlet, self.tied_dofs]).astype(np.int64)
        self.bounded_nodes = np.flatnonzero(bounded)
        self.bounded = (self.d * self.bounded_nodes).astype(np.int32)

    def current_coordinates(self) -> PETSc.Vec:
        """Return X + u as a vector (also with frozen geometry: the gap is linear in u)."""
        x = self.vectors["x"]
        x.array[:] = self.X.ravel() + self.u.x.array[: self.d * self.n]
        return x

    def gaps(self) -> Floats:
        """Return (owned nodes,) how far w_n may still grow, n_j.(P x - x_j); collective."""
        x = self.current_coordinates()
        gap = np.full(self.n, np.inf)
        for contact in self.contacts:
            kept = contact.kept[:, 0]
            gap[contact.pattern.nodes[kept]] = -contact.relative(x)[kept, 0]
        return gap

    def _eliminated_increment(self) -> Floats:
        """Return the increments of the eliminated unknowns: Dirichlet data, then ties."""
        own = self.d * self.n
        u = self.vectors["x"]
        u.array[:] = self.u.x.array[:own]
        slip = np.zeros((self.n, self.d))
        for tie in self.ties:
            nodes = tie.pattern.nodes
            slip[nodes] = np.where(tie.S, -tie.relative(u), slip[nodes])
        dirichlet = self.target[self.dirichlet_dofs] - self.u.x.array[self.dirichlet_dofs]
        return np.concatenate([dirichlet, slip.ravel()[self.tied_dofs]])

    # -- the quadratic program -------------------------------------------------------------------

    def quadratic_program(self) -> BoundQP:
        """Assemble min 1/2 dy.K^ dy - r^.dy with its bounds at the present u; collective."""
        v = self.vectors
        with self.timings("assembly"):
            self.solid.assemble_tangent(self.K)
            self.solid.assemble_residual(v["F"])
        v["F"].copy(v["r"])
        v["r"].aypx(-1.0, v["f"])
        with self.timings("transform"):
            A = self.K if self.transformation is None else self.transformation.transform(self.K)
            b = self.to_reduced(v["r"])
            v["dy"].set(0.0)
            v["dy"].array[self.eliminated] = self._eliminated_increment()
            diagonal = A.getDiagonal()
            self.diagonal = diagonal
            rows = (self.eliminated + self.first_dof).astype(PETSc.IntType)
            A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            A.zeroRowsColumns(rows, diag=diagonal.sum() / diagonal.getSize(), x=v["dy"], b=b)
            A.setOption(PETSc.Mat.Option.SPD, True)
            v["lower"].set(PETSc.NINFINITY)
            v["upper"].set(PETSc.INFINITY)
            self.gap = self.gaps()
            v["upper"].array[self.bounded] = self.gap[self.bounded_nodes]
        return BoundQP(A, b, v["lower"], v["upper"], self.bounded)

    def multiplier_weights(self) -> Floats:
        """Return D_jj of the bounded unknowns."""
        weights = np.ones(self.n)
        for contact in self.contacts:
            kept = contact.S[:, 0]
            weights[contact.pattern.nodes[kept]] = contact.weight[kept, 0]
        return np.asarray(weights[self.bounded_nodes])

    def violation(self, length: float, dy: PETSc.Vec) -> float:
        """Return sum_j D_jj (w_n - gap)_+ after a part of an increment; collective."""
        excess = length * dy.array_r[self.bounded] - self.gap[self.bounded_nodes]
        local = self.multiplier_weights() @ np.maximum(excess, 0.0)
        return float(self.comm.allreduce(float(local), op=MPI.SUM))

    def to_reduced(self, forces: PETSc.Vec) -> PETSc.Vec:
        """Return T^T times a force vector; collective."""
        result = forces.duplicate()
        if self.transformation is None:
            forces.copy(result)
        else:
            self.transformation.apply_transposed(forces, result)
        return result

    def to_displacement(self, dy: PETSc.Vec) -> PETSc.Vec:
        """Return du = T dy; collective."""
        du = self.vectors["du"]
        if self.transformation is None:
            dy.copy(du)
        else:
            self.transformation.apply(dy, du)
        return du

    # -- results ---------------------------------------------------------------------------------

    def set_results(self, reaction: PETSc.Vec) -> None:
        """Set the interfaces' resultants and Functions from the QP's reactions; collective."""
        moved = self.X + self.u.x.array[: self.d * self.n].reshape(-1, self.d)
        gap = self.gaps()
        forces = self.to_reduced(self.vectors["r"]).array_r.reshape(-1, self.d)
        z = reaction.array_r[:: self.d]
        for interface in self.interfaces:
            nodes = interface.pattern.nodes
            frozen = interface.configuration(self.configuration) is None
            x = self.X if frozen else moved  # where the forces act
            if isinstance(interface, Contact):
                kept = interface.S[:, 0]
                interface.set_results(
                    np.where(kept, z[nodes], 0.0), kept & self.active[nodes], gap[nodes], x
                )
            elif isinstance(interface, Tie):
                interface.set_results(np.where(interface.S, forces[nodes], 0.0), x)

    def commit(self) -> None:
        """Make the converged step the state from which the next one starts; collective."""
        with self.timings("commit"):
            self.solid.evaluate()
            self.solid.commit()

    def output_fields(self) -> dict[str, fem.Function]:
        """Return the Functions worth writing, by name; collective.

        The displacement, ``solid.output_fields()``, and the interfaces' pressure, gap and status.
        """
        fields = {"displacement": self.u} | self.solid.output_fields()
        for name in ("pressure", "gap", "status") if self.interfaces else ():
            if name not in self._outputs:
                space = self.interfaces[0].pressure.function_space
                self._outputs[name] = fem.Function(space, name=name)
            fields[name] = merge_results(self.interfaces, name, self._outputs[name])
        return fields
