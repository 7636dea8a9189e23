# SPDX-License-Identifier: MIT
"""Bodies, interfaces, supports and loads of a load step."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.algebra.parallel import (
    any_rank,
    from_callbacks,
    largest,
    raised_together,
)
from dolfinx_mortar.audit.audit import Audit, create_audit
from dolfinx_mortar.audit.mesh_audit import check_axis, check_mesh
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.common.spaces import with_values
from dolfinx_mortar.common.step_report import LoadStep, Timings
from dolfinx_mortar.interfaces.interface import Interface, check_owned
from dolfinx_mortar.interfaces.results import merge_results
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.system import Configuration, InterfaceSystem
from dolfinx_mortar.interfaces.tool import Tool
from dolfinx_mortar.persistence import checkpoints
from dolfinx_mortar.persistence.committed import Before, Committed, ProblemState, StepOutcome
from dolfinx_mortar.problem.checks import StepData, check_arguments, check_jumps
from dolfinx_mortar.problem.preconditioning import UnknownsOfBodies
from dolfinx_mortar.qp import LinearSolver, check_options
from dolfinx_mortar.solid.solid import Solid, flows_at_start
from dolfinx_mortar.solid.supports import (
    Bodies,
    Dirichlet,
    check_targets,
    create_dirichlet,
    find_bodies,
    with_ties,
)
from dolfinx_mortar.solid.term import Term
from dolfinx_mortar.terms.inertia import Inertia
from dolfinx_mortar.terms.sum import Terms, check_terms
from dolfinx_mortar.terms.weak_forms import DeadLoads, WeakForm, check_form

log = logging.getLogger(__name__)

Predictor = Callable[["ContactProblem", StepData, float | None, Floats], StepData]


class ContactProblem:
    """Elasto-plastic bodies with contact and mesh tying under Dirichlet data and loads.

    A step minimises J(v) = Psi(v) - f.v over B_E v = c_E, B_I v <= c_I (paper, eqs. 2-4).

    Args:
        solid: displacement, materials and committed state of the bodies.
        interfaces: contacts and ties; a slave node belongs to the first one whose master it faces.
        bcs: Dirichlet conditions on ``solid.u`` or its components, read in every step.
        loads: linear form of the external virtual work, assembled in every step.
        potential: functional of ``solid.u`` added to Psi. The solid's kinematics give both forms
            their weight: with "axisymmetric" write tractions without 2 pi r.
        terms: further energies, forces and stiffnesses, see `Term` and `WeakForm`.
        geometry: "updated" computes normals, segments, D, M and gaps at X + u in every Newton
            iteration, "reference" once at X.
        petsc_options_prefix: prefix of the linear solver's PETSc options.
        petsc_options: these options without the prefix; see `load_steps` for multigrid that fails.

    Raises:
        ValueError: for invalid arguments, on all ranks.

    Attributes:
        u, V: displacement and its space.
        bcs, interfaces: Dirichlet conditions and interfaces as given.
        contacts, ties: unilateral interfaces (`Contact`, `Obstacle`, or a user's subclass), others.
        committed: the state from which the next step starts, besides ``u`` and ``solid.state``:
            active sets, slips and ``level``.
        history: steps of `load_steps`, including those before a restored checkpoint.
        d, n, first_dof, comm: dimension, owned nodes, number of the first owned dof, ranks.
        X, fixed: coordinates (owned nodes, d), components (local nodes, d) with Dirichlet data.
        owned_u, K: u (n d,) at owned dofs, a view, and the tangent with respect to it.
    """

    def __init__(
        self,
        solid: Solid,
        interfaces: Sequence[Interface] = (),
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        loads: ufl.Form | None = None,
        potential: ufl.Form | None = None,
        terms: Sequence[Term] = (),
        geometry: str = "updated",
        petsc_options_prefix: str = "dolfinx_mortar_",
        petsc_options: Mapping[str, Any] | None = None,
    ) -> None:
        sides, conditions = check_arguments(
            *(solid, interfaces, bcs, loads, potential, geometry),
            terms=terms,
            petsc_options_prefix=petsc_options_prefix,
            petsc_options=petsc_options,
        )
        with raised_together(solid.V.mesh.comm):
            for side in sides:
                revolved = solid.kinematics.radius is not None
                side.check(solid.V, revolved, solid.strain)
        check_options(solid.V.mesh.comm, petsc_options_prefix, petsc_options)
        self.solid, self.geometry = solid, geometry
        self.u, self.V, self.comm = solid.u, solid.V, solid.V.mesh.comm
        nodes, self.d = self.V.dofmap.index_map, int(self.V.dofmap.index_map_bs)
        self.n, self.first_dof = int(nodes.size_local), int(self.d * nodes.local_range[0])
        self.X: Floats = self.V.tabulate_dof_coordinates()[: self.n, : self.d]
        self.owned_u: Floats = self.u.x.array[: self.d * self.n]
        # displacement at which normals and segments are taken, None for X
        self.configuration = self.u if geometry == "updated" else None
        self.timings = Timings()
        self.logged = set[str]()
        self.told = list[list[str]]()  # notes on the last step, or on its failure
        kinematics = solid.kinematics
        self.terms = _create_terms(solid, loads, potential, terms)
        self.in_time = any(isinstance(term, Inertia) for _, term in self.terms.named)
        self.inputs = solid.given | {"bcs": conditions, "loads": loads, "potential": potential}
        self.inputs |= {"terms": terms, "interfaces": sides}
        self.supports: Dirichlet = create_dirichlet(solid.V, conditions)
        self.fixed, self.bcs = self.supports.fixed, self.supports.bcs
        with self.timings("mortar"):
            at_points = None if kinematics.unweighted else kinematics.weights_at
            self.system = InterfaceSystem(self.V, sides, self.supports.fixed, at_points)
            for interface in sides:
                interface.take(self.supports, self.V)
        self.interfaces: list[Interface] = self.system.interfaces
        self.contacts: list[Any] = [i for i in self.interfaces if i.unilateral]
        self.ties: list[Any] = [i for i in self.interfaces if not i.unilateral]
        bodies = find_bodies(self.V, kinematics.rigid_motions)
        joined = [s for s in self.system.sides if not s.unilateral and s.master]
        self.bodies: Bodies = with_ties(bodies, [s.on_slave | s.on_master for s in joined])
        self.terms.meet(self.system.can_open, self.bodies.label)
        motions = kinematics.nearly_rigid or kinematics.rigid_motions
        with self.timings("setup"):
            self.linear = LinearSolver(
                self.comm,
                prefix=petsc_options_prefix,
                options=petsc_options,
                multigrid=self.d == 3,
            )
            self.K = self.terms.create_matrix(blocks=not self.linear.direct)
            self.operator = CongruentOperator(self.K)
            # the problem would keep its matrices alive
            self.linear.unknowns = UnknownsOfBodies(
                self.operator, self.system, self.supports, replace(self.bodies, motions=motions)
            )
        slips = np.zeros((2, len(sides), self.n))
        self.committed = Committed(np.zeros(self.n, dtype=bool), self.owned_u.copy(), *slips)
        self.history: list[LoadStep] = self.committed.history
        parts = solid, self.interfaces, self.system, self.supports, geometry
        self.state = ProblemState(*parts, self.committed, self.terms.named)  # for checkpoints
        self.outcome: StepOutcome | None = None

    def vector(self, values: Floats | None = None) -> PETSc.Vec:
        """New vector of owned dofs."""
        v = self.K.createVecRight()
        v.array[:] = 0.0 if values is None else values.ravel()
        return v

    def begin_step(self, level: float | None = None, predict: Predictor | None = None) -> StepData:
        """Read loads, Dirichlet values and jumps, predict u, pair the surfaces; collective.

        Bodies, tied ones together, are translated by the mean of their prescribed increments.
        `level` is that of the step, None for the committed one; `predict` is a further prediction.

        Raises:
            ValueError: for NaN, infinity or contradictions in the data; negative friction limits,
                points that leave an axis, invalid jumps, interfaces of another problem.
        """
        check_owned(self.interfaces, self.supports)
        data = self._read(level)
        before = self.owned_u.copy()
        self.move(before + self._carried(data.asked, before))
        data = replace(data, begun=self.owned_u.copy())
        if predict is not None:
            data = predict(self, data, level, before)
        audit = not self.committed.begun
        if audit:
            self._check_mesh()
        with self.timings("mortar"):
            found, partners = self._pair(data.target)
            increment = max(data.increment, found.largest_slip(self.vector(self.owned_u)))
            data = replace(data, increment=increment, partners=partners)
        self.update_geometry(found)
        if audit:
            audited = self._audit(data.increment)
            if self.comm.rank == 0:
                log.info("%s", "; ".join(map(str, audited.interfaces)) or "no interface")
                for warning in audited.warnings:
                    if warning not in self.logged:
                        log.warning("%s", warning)
                self.logged.update(audited.warnings)
        return data

    def _read(self, level: float | None) -> StepData:
        limits = []
        for contact in self.contacts:
            if contact.wear is not None:
                contact.wear_by(np.zeros(0), np.zeros(0, dtype=np.int32))
        if self.system.has_friction:
            laws = [(one.law, one.nodal) for one in self.interfaces]
            limits = [None if law is None else law.values(results) for law, results in laws]
        target = self.supports.values()
        for name, array, remedy in (
            ("bcs", target[self.supports.owned.ravel()], "check the values of the conditions"),
            ("u", self.u.x.array, "start from a finite displacement"),
        ):
            bad = self.comm.allreduce(int(np.sum(~np.isfinite(array))))
            if bad:
                raise ValueError(f"{name}: {bad} values are NaN or infinite; {remedy}")
        start = self.committed.level
        with self.timings("assembly"):
            self.terms.begin(start, start if level is None else level)
            flows = flows_at_start(self.solid)
        check_targets(self.solid, target)
        check_jumps(self.system)
        asked = self.supports.increment(target, self.u.x.array)
        increment = max(largest(self.comm, asked), self.terms.stride())
        last = self.ended_here() or self.committed
        contacts = last.active, last.sliding
        return StepData(target, asked, increment, contacts, limits, flows=flows)

    def _carried(self, asked: Floats, u: Floats) -> Floats:
        """Rigid motion (n,) of the bodies from u with prescribed increments (owned nodes, d)."""
        bodies, owned = self.bodies, self.supports.owned
        motion = bodies.mean(asked, owned)[bodies.label] * bodies.shifts
        if self.solid.strain == "finite" and bodies.shifts.all():
            motion = motion + bodies.turned(asked, owned, self.X + u.reshape(self.X.shape))
        return motion.ravel()

    def _pair(self, target: Floats) -> tuple[Configuration, list[Partners | None]]:
        """Pair the surfaces at u; also slip partners at the last commit.

        Those that are missing there are, in the first step, those after the rigid motion.
        """
        frozen, began = self.geometry == "reference", self.committed.displacement
        start, paired = self.vector(self.X.ravel() + began), self.committed.paired
        places = [began if self.system.has_friction and not frozen else self.owned_u]
        if self.system.has_friction and not (frozen or self.committed.begun):
            places.append(began + self._carried(self.supports.increment(target, began), began))
        chosen = list[list[Partners | None] | None]()

        def partners(at: Configuration) -> list[Partners | None]:
            return [link.partners(start, frozen=frozen) for link in at.links]

        for place in places:
            here = not any_rank(self.comm, not np.array_equal(self.owned_u, place))[0]
            at = None if here else self.system.begin(with_values(self.V, place), paired)
            chosen.append(None if at is None else partners(at))
        found = self.system.begin(self.configuration, paired)
        result, *others = (p or partners(found) for p in chosen)
        for other in others:
            pairs = zip(found.links, result, other, strict=True)
            result = [a and b and a.completed(link, b) for link, a, b in pairs]
        return found, result

    def audit(self) -> Audit:
        """Geometry audit at the present displacement; collective.

        Raises:
            ValueError: if a body can move freely, two surfaces can never meet, or a later problem
                uses an interface.
        """
        check_owned(self.interfaces, self.supports)
        self._check_mesh()
        asked = self.supports.increment(self.supports.values(), self.u.x.array)
        increment = largest(self.comm, asked)
        with self.system.put_back():
            with self.timings("mortar"):
                found = self.system.at(self.configuration)
                self.system.enter(found)
            audit = self._audit(increment)
            return audit

    def _check_mesh(self) -> None:
        check_mesh(self.V.mesh)
        check_axis(self.solid, self.supports, self.system.sides)

    def _audit(self, increment: float) -> Audit:
        springs = self.terms.resistance()
        at, parts = self.configuration, (self.bodies, self.system, self.supports)
        return create_audit(*parts, self.positions(), springs, at=at, increment=increment)

    def diagnose(self) -> list[str]:
        """Notes on the last step, or on its failure, with remedies."""
        return [
            ". ".join(filter(None, (note, getattr(note, "why", "")))) for note in chain(*self.told)
        ]

    def update_geometry(self, found: Configuration | None = None) -> None:
        """Pair the surfaces at X + u (X if frozen), and compute D, M, N and T; collective."""
        with self.timings("mortar"):
            if self.system.enter(found or self.system.at(self.configuration)):
                self.linear.clear()

    def follow_geometry(self) -> None:
        """Update the geometry to X + u within a step; collective."""
        with self.timings("mortar"):
            if self.system.follow(self.configuration):
                self.linear.clear()

    def move(self, u: Floats) -> None:
        """Set the displacement (n,); collective."""
        self.owned_u[:] = u
        self.u.x.scatter_forward()

    def positions(self) -> PETSc.Vec:
        """Vector X + u."""
        return self.vector(self.X.ravel() + self.owned_u)

    def commit(self) -> None:
        """Make the converged step the state from which the next one starts; collective.

        An error, or Ctrl-C, restores the last commit. A ValueError if a later problem uses an
        interface.
        """
        check_owned(self.interfaces, self.supports)
        outcome = self.ended_here()
        before = outcome.before if outcome and outcome.before else Before(self.state, None)
        with self.timings("commit"), self.undone(before):
            ended = outcome.ended if outcome else ()
            ended = ended or [interface.state(True) for interface in self.interfaces]
            self.terms.commit()
            self.committed.commit(self.owned_u, outcome)
            with raised_together(self.comm):
                for interface, end in zip(self.interfaces, ended, strict=True):
                    interface.restore(end)
            self.outcome = None

    @contextmanager
    def undone(self, before: Before) -> Iterator[None]:
        """Undo the step if the block fails, perhaps on this rank only."""
        try:
            with from_callbacks():
                yield
        except BaseException:
            self.undo(before)
            self.linear.abandon()
            raise

    def undo(self, before: Before) -> None:
        """Restore the state before a step; not collective."""
        before.restore()
        self.outcome = before.outcome

    def go_back(self) -> None:
        """Undo a step in time that has not been committed; collective.

        Quasi-static steps keep the present u as initial guess.
        """
        outcome = self.ended_here() if self.in_time else None
        if outcome is not None and outcome.before is not None:
            self.undo(outcome.before)

    def ended_here(self) -> StepOutcome | None:
        """Outcome of the last step, None if u has changed; collective."""
        elsewhere = self.outcome is None or not np.array_equal(self.outcome.at, self.owned_u)
        return None if any_rank(self.comm, elsewhere)[0] else self.outcome

    @property
    def steps_done(self) -> tuple[int, int]:
        """Numbers of load steps, all and restored from a checkpoint."""
        return len(self.history), self.committed.brought

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint for `restore` on any number of ranks; collective.

        It contains what steps compute, also `history`; not loads, supports, jumps, parameters and
        variable eigenstrain. Bodies that coincide cell by cell cannot be restored.

        Args:
            path: HDF5 file in an existing folder; replaced once the new one is complete.

        Raises:
            OSError: on all ranks, if it cannot be written; the older file remains.
            ValueError: if the last step is not committed, or another problem uses an interface.
            RuntimeError: if h5py is missing (an ImportError on rank 0).
        """
        if self.ended_here() is not None:
            raise ValueError(
                "problem: the last step is not committed: call problem.commit() before save()"
            )
        with self.timings("checkpoint"):
            checkpoints.save(self.state, path)

    def restore(self, path: str | os.PathLike[str]) -> None:
        """Restore the state of a checkpoint, written on any number of ranks; collective.

        Mesh (in any numbering), materials and interfaces must be the same. Before an evaluation set
        loads to ``committed.level``, and after changes of parameters call ``solid.follow()``;
        `load_steps` does both.

        Raises:
            OSError: on all ranks, if the file is missing or unreadable.
            ValueError: on all ranks, if it is damaged, or of another version or problem, with the
                differences; nothing is changed.
        """
        with self.timings("checkpoint"):
            checkpoints.read(self.state, path).put()
            self.outcome = None

    def output_fields(self) -> dict[str, fem.Function]:
        """Functions for output by name; collective.

        The displacement, ``solid.output_fields()``, and of the interfaces "pressure", "gap",
        "facing" (1 at slave nodes that face a master; elsewhere the gap is 0) and "status"; with
        friction also "traction" and "slip", with wear "wear_depth". A ValueError if a later problem
        uses an interface.
        """
        check_owned(self.interfaces, self.supports)
        fields = {"displacement": self.u} | self.solid.output_fields()
        names = ["pressure", "gap", "facing", "status"] if self.interfaces else []
        names += ["traction", "slip"] if self.system.has_friction else []
        names += ["wear_depth"] if any(one.wear is not None for one in self.interfaces) else []
        for name in names:
            scalar = self.interfaces[0].pressure.function_space
            merged = fem.Function(self.V if name == "traction" else scalar, name=name)
            fields[name] = merge_results(self.system.sides, self.interfaces, name, merged)
        return fields

    def output_tools(self) -> list[tuple[Tool, Floats]]:
        """See `InterfaceSystem.tools_at`; collective."""
        return self.system.tools_at(self.u)


def _create_terms(
    solid: Solid, loads: ufl.Form | None, potential: ufl.Form | None, terms: Sequence[Term]
) -> Terms:
    own = check_terms(solid.V.mesh.comm, terms, solid.u)
    named: list[tuple[str, Term]] = []
    if loads is not None:
        named.append(("loads", DeadLoads(solid, loads)))
    if potential is not None:
        check_form(solid.u, "potential", potential)
        named.append(("potential", WeakForm(solid, energy=potential)))
    named += [(f"terms[{k}], a {type(term).__name__}", term) for k, term in enumerate(own)]
    return Terms(solid, named)
