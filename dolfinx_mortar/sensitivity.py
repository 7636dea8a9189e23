# SPDX-License-Identifier: MIT
"""Derivatives of a converged step by parameters (docs/guide/sensitivities.md).

With its active set a step satisfies f = T^T r - D t = 0 on free unknowns, t tractions, and w = 0:
gaps of closed nodes, slips of sticking ones, the law of slipping ones, Dirichlet data and ties.
Central differences give f' and w' along the parameter, u, t and the committed state; K^ y = f' with
y = w' at held unknowns, K^ the exact tangent, corrects u' and t' until both vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, largest, norm, ratio
from dolfinx_mortar.common.arguments import FINITE, Rule, check, instance
from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, QUARTER_OF_DIGITS, SAME, TINY, Floats
from dolfinx_mortar.interfaces.constraints import SlipLimits
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.persistence.committed import Before
from dolfinx_mortar.problem.checks import StepData, check_problem
from dolfinx_mortar.problem.contacts import Contacts, largest_force
from dolfinx_mortar.problem.linearisation import (
    Balance,
    find_balance,
    linearise,
    to_displacement,
)
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp.held import TIGHT, HeldProblem, State
from dolfinx_mortar.report.certificate import set_results
from dolfinx_mortar.report.reaction import support_forces

# Relative step of differences; relative residual of a converged step.
STEP, CONVERGED = EPS ** (1 / 3), 1e-5

Way = tuple[Callable[[float], None], float]  # what sets p + h e, and |p| / |e|

LIST = instance((list, tuple), "give a list")
QUANTITY = Rule[Any](
    "give a function without arguments, or a functional in UFL",
    lambda q: None if not callable(q) or (isinstance(q, ufl.Form) and q.arguments()) else q,
)
PARAMETER = (
    "give a Constant, a Function, (Constant or Function, direction), (mesh, Function on V), or "
    "(object, name of a number)"
)


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives by all components of the parameters, see `sensitivity`.

    Attributes:
        values: of each quantity an array of its shape, and last the components.
        du: (components, n) of the owned displacements.
        notes: where derivatives are one-sided or inaccurate.
        to: the parameters.
        state: (components, m) of this rank's state at the end of the step.
        at: (n,) owned displacements of the step.
    """

    values: list[Floats]
    du: Floats
    notes: list[str]
    to: Sequence[Any]
    state: Floats
    at: Floats


def sensitivity(problem: ContactProblem, *, of: Sequence[Any], to: Any) -> Sensitivity:
    """Derivatives of quantities by parameters in a converged step; collective.

        found = dm.sensitivity(problem, of=[lambda: contact.force[1]], to=[E, nu])
        found.values[0][1]  # d force / d nu

    The active set is that of the step. Everything is restored to the last bit.

    Args:
        problem: after ``newton``, with internal variables or friction before ``commit``.
        of: functions without arguments that return a number or an array of results, the same on
            all ranks, and functionals in UFL, with no weight but their own.
        to: Constants, Functions (by each global dof), pairs (Constant or Function, direction) with
            an array or Function, (mesh, direction) of the nodal coordinates with a Function on V,
            (object, name) of a number, such as (sphere, "radius"). Or the result of the step
            before, so that derivatives of the committed state count, too.

    Raises:
        ValueError: on all ranks, before a converged step, or if data have changed since; for
            parameters that nothing reads; for inertia, given loads of tools and bolts, and a
            history without its derivatives.
    """
    check_problem(problem, ContactProblem)
    check_owned(problem.interfaces, problem.supports)
    step, system, parts = _Step(problem, of, to), problem.system, vars(problem).copy()
    before = Before(problem.state, problem.outcome)
    problem.linear = copy(problem.linear)
    problem.linear.abandon()
    try:
        with system.put_back():
            try:
                return step.solve()
            finally:
                vars(problem).update(parts)
                problem.undo(before)
    finally:
        problem.terms.begin(problem.committed.level, step.level)
        problem.solid.follow()


class _Tangent:
    """f and w at given forces and constraints, and their linear system."""

    def __init__(
        self, problem: ContactProblem, contacts: Contacts, data: StepData, balance: Balance
    ) -> None:
        t = contacts.tangential if data.limits else None
        moving = problem.configuration is not None and problem.system.links
        given = (contacts.multipliers, t, data.partners) if moving else None
        lin = linearise(problem, balance, moving=given)
        qp, bounds, limits = replace(lin.qp, extent=0.0), balance.bounds, balance.limits
        if qp.product is not None:
            qp = replace(qp, A=qp.A.duplicate(copy=True), product=None)
        self.linear = copy(problem.linear)
        self.linear.abandon()
        self.linear.set_matrix(qp.A, definite=qp.definite, near=qp.near)
        self.T = problem.system.transformation if lin.geometry is None else lin.geometry.trial
        self.problem, self.contacts, self.qp = problem, contacts, qp
        self.limits: Any = limits
        on, self.equal, z = contacts.active[balance.nodes], balance.equal.dofs, balance.reduced
        self.state = State.create(qp, on.astype(np.int8), contacts.directions(limits))
        self.normal, self.nodes, self.D = bounds.dofs[on], balance.nodes[on], bounds.weight[on]
        self.bound = np.isin(np.arange(z.local_size), [*self.equal, *self.normal])
        self.scale = np.abs(lin.diagonal.array)
        if (law := qp.friction) is not None:
            kappa = np.asarray(contacts.kappa(limits))
            kappa = np.where(law.across & np.isfinite(kappa), kappa, self.state.stiffness)
            self.state = replace(self.state, stiffness=kappa)
            self.slips = self.state.slips(law)[:, None] & law.some
            self.acts = law.acts(on[law.normal])[:, None] & law.some
            self.bound[law.tangential[self.acts]] = True
            self.scale[law.tangential[self.slips]] = 1.0
        force, gap = contacts.reactions(balance), np.abs(bounds.upper) * self.scale[bounds.dofs]
        self.force = largest_force(problem.comm, balance, force)
        f, w = self.residual(balance, contacts)
        f[self.equal] = 0.0
        if self.size(f, w) > CONVERGED:
            raise ValueError("problem: u does not solve it with the present data: call newton()")
        weak = np.where(on, force, gap) <= QUARTER_OF_DIGITS * largest(problem.comm, force)
        self.weak = problem.comm.allreduce(int(weak.sum()))

    def residual(self, balance: Balance, contacts: Contacts) -> Floats:
        """Forces f and gaps w (2, n)."""
        found = np.stack([balance.reduced.array_r, 0.0 * self.scale])
        found[0, balance.bounds.dofs] -= contacts.reactions(balance)
        for part in (balance.equal, balance.bounds):
            found[1, part.dofs] = part.upper
        if (limits := balance.limits) is not None:
            some, z, (mu, cohesion) = (
                limits.some,
                contacts.tangential_reactions(limits),
                limits.left,
            )
            most = mu * contacts.multipliers[limits.nodes] + cohesion / limits.weight
            law = most[:, None] * self.directions(limits) - z / limits.weight[:, None]
            w = np.where(self.slips, self.limits.weight[:, None] * law, -limits.slip)
            some = limits.some
            found[:, limits.tangential[some]] += np.stack([-z[some], w[some]])
        found[1, ~self.bound] = 0.0
        return found

    def directions(self, limits: SlipLimits) -> Floats:
        """Directions of slip (m, t), which turn in space."""
        size = np.linalg.norm(limits.slip, axis=1, keepdims=True)
        turns = limits.some.all(axis=1, keepdims=True) & (self.problem.d > 2) & (size > 0.0)
        unit = limits.slip / np.where(turns, size, 1.0)
        return np.where(turns, unit, np.asarray(self.contacts.directions(limits)))

    def size(self, f: Floats, w: Floats) -> float:
        """Size relative to the forces."""
        return ratio(norm(self.problem.comm, f, w * self.scale), self.force)

    def correct(self, f: Floats, w: Floats) -> tuple[Floats, Floats]:
        """Changes of u' and t'."""
        problem, law, upper = self.problem, self.qp.friction, self.qp.upper.copy()
        b, dt = f.copy(), np.zeros((1 + problem.d, problem.n))
        b[self.equal] = 0.0
        upper.array[self.normal] = w[self.normal]
        if law is not None:
            w_t, cohesion = law.pick(w), np.where(law.cohesion > 0.0, TINY, 0.0)
            slid = np.where(self.slips, w_t, 0.0)
            law.put(b, law.pick(b) - slid)
            law = replace(law, rest=w_t - slid, cohesion=cohesion)
        qp = replace(self.qp, b=problem.vector(b), upper=upper, friction=law)
        held = HeldProblem(qp, self.linear, problem.vector(), SAME)
        held.solve(self.state, TIGHT)
        z = held.z.array_r
        dt[0, self.nodes] = z[self.normal] / self.D
        if law is not None:
            t = self.acts * (law.pick(z) + slid) / self.limits.weight[:, None]
            dt[1:, self.limits.nodes] = self.limits.vectors(t).T
        return self.lifted(held.x, w), dt

    def lifted(self, y: PETSc.Vec, w: Floats) -> Floats:
        """Displacement of y, and w at Dirichlet data and ties."""
        y.array[self.equal] = w[self.equal]
        return np.array(to_displacement(self.T, y).array)


class _Step:
    """A converged step, and what is beside it."""

    def __init__(self, problem: ContactProblem, of: Sequence[Any], to: Any) -> None:
        last, outcome = to if isinstance(to, Sensitivity) else None, problem.ended_here()
        committed, interfaces, at = problem.committed, problem.interfaces, problem.owned_u
        off, gone = any_rank(
            problem.comm,
            not (committed.begun and np.array_equal(committed.displacement, at)),
            last is not None and not np.array_equal(last.at, committed.displacement),
        )
        remembers = bool(problem.solid.state) or problem.system.has_friction
        with_state = any(term.state for _, term in problem.terms.named)
        on_tools = any(one.law and one.tool for one in interfaces)
        for why, wrong in {
            "there is no converged step: call newton(problem)": off and not outcome,
            "the committed step has a history: call it before commit()": remembers and not outcome,
            "there are committed steps: give as to= the result of the last one": remembers
            and committed.begun
            and last is None,
            "to= is the result of another step than the last one": gone,
            "friction on tools has a history after the first step": on_tools and committed.begun,
            "loads drive a tool, a rigid side or a bolt": any(i.driven() for i in interfaces),
            "inertia or terms have a state": problem.in_time or with_state,
        }.items():
            if wrong:
                raise ValueError(f"problem: no derivatives here, {why}")
        self.problem, self.notes, self.moves = problem, list[str](), False
        self.to = check("to", to if last is None else last.to, LIST)
        self.of = [check(f"of[{k}]", q, QUANTITY) for k, q in enumerate(check("of", of, LIST))]
        ended = outcome or committed
        self.level = committed.level if ended.level is None else ended.level
        parts = [f.x.array for f in problem.solid.state.values()]
        self.past = [*parts, committed.displacement, committed.slid, committed.dissipated]
        self.u, self.began = at.copy(), np.concatenate([values.ravel() for values in self.past])
        self.rates = None if last is None else last.state
        self.tractions: Floats = np.zeros((1 + problem.d, problem.n))
        for link in problem.system.unilateral:
            on, one = link.constrained[:, 0], link.interface
            nodes = link.nodes[on]
            self.tractions[0, nodes] = one.multiplier[on]
            if one.law is not None:
                t = one.nodal["traction"].x.array.reshape(-1, problem.d)
                self.tractions[1:, nodes] = -t[nodes].T
        self.base = Contacts(ended.active, self.tractions[0], sliding=ended.sliding)
        self.put(0.0)

    def put(self, h: float, du: Any = 0.0, dt: Any = 0.0, rates: Any = 0.0) -> None:
        """Set state, u and tractions."""
        state, first = self.began + h * rates, 0
        for values in self.past:
            values[...] = state[first : first + values.size].reshape(values.shape)
            first += values.size
        self.at, (normal, *others) = self.u + h * du, self.tractions + h * dt
        self.contacts = replace(self.base, multipliers=normal, tangential=np.transpose(others))

    def differ(self, evaluate: Callable[[], Floats], h: float, way: Way, *along: Any) -> Floats:
        """Derivative of what a function returns."""
        found = []
        try:
            for s in (h, -h):
                way[0](s)
                self.put(s, *along)
                found.append(evaluate())
        finally:
            way[0](0.0)
            self.put(0.0)
        return np.asarray((found[0] - found[1]) / (2.0 * h))

    def balance(self) -> tuple[StepData, Balance]:
        """Forces and constraints."""
        problem, kinematics = self.problem, self.problem.solid.kinematics
        if self.moves:
            problem.X = problem.V.tabulate_dof_coordinates()[: problem.n, : problem.d]
            weight = None if kinematics.unweighted else kinematics.weights_at
            given = problem.interfaces, problem.supports.fixed, weight
            problem.system = InterfaceSystem(problem.V, *given)
        data = problem.begin_step(self.level)
        problem.move(self.at)
        problem.follow_geometry()
        return data, find_balance(problem, data, 0.0, self.contacts.multipliers)

    def residual(self) -> Floats:
        """Forces f and gaps w (2, n)."""
        return self.tangent.residual(self.balance()[1], self.contacts)

    def results(self) -> Floats:
        """Quantities, and the state at the end of the step."""
        problem, (_, balance), committed = self.problem, self.balance(), self.problem.committed
        slips, _ = set_results(problem, balance, self.contacts.completed(balance.limits))
        committed.supports = support_forces(problem, balance)
        problem.solid.evaluate()
        ends = [f.x.array for f in problem.solid.points.staged.values()]
        totals = slips or committed
        parts = [*(q() for q in self.of), *ends, self.at, totals.slid, totals.dissipated]
        return np.concatenate([np.ravel(part) for part in parts])

    def direct(self, way: Way, *rates: Any) -> tuple[Floats, Floats]:
        """Derivatives of results and u."""
        comm, left, tangent = self.problem.comm, 2.0, self.tangent
        dt: Any = 0.0
        h, u = STEP * (way[1] or 1.0), norm(self.problem.comm, self.u)
        f, w = self.differ(self.residual, h, way, 0.0, dt, *rates)
        if 0.0 < (effect := h * tangent.size(f, w)) < np.inf:
            h *= (STEP / effect) ** (1 / 3 if way[1] else 1)
        du = tangent.lifted(self.problem.vector(), w)
        while True:
            f, w = self.differ(self.residual, h, way, du, dt, *rates)
            change, more = tangent.correct(f, w)
            du, dt, last = du + change, dt + more, left
            least = QUARTER_OF_DIGITS * STEP * u / h
            left = ratio(norm(comm, change), max(norm(comm, du), least))
            if left * left <= HALF_OF_DIGITS * last or left > 0.5 * last:
                break
        if left > STEP:
            self.notes.append(f"derivatives are accurate to {left:.1e} only")
        found = self.differ(self.results, h, way, du, dt, *rates)
        if not (effect or any_rank(comm, found.any())[0] or self.reads(way)):
            raise ValueError("to: nothing reads one of the parameters; leave it out")
        return found, du

    def reads(self, way: Way) -> bool:
        """Whether NaN or zero makes a difference or an error."""
        base = self.residual()
        for h in (np.nan, -way[1]):
            try:
                way[0](h)
                changes = self.moves or not np.array_equal(self.residual(), base)
                if any_rank(self.problem.comm, changes)[0]:
                    return True
            except ValueError:
                return True
            finally:
                way[0](0.0)
        return False

    def solve(self) -> Sensitivity:
        """Derivatives of all."""
        comm = self.problem.comm
        for k, q in enumerate(self.of):
            if isinstance(q, ufl.Form):
                form = fem.form(q)
                self.of[k] = lambda form=form: comm.allreduce(fem.assemble_scalar(form))
        shapes = [np.shape(q()) for q in self.of]
        self.tangent = _Tangent(self.problem, self.contacts, *self.balance())
        if weak := self.tangent.weak:
            self.notes.append(f"{weak} nodes are about to open or close: one-sided derivatives")
        ways = [way for k, p in enumerate(self.to) for way in self.ways(f"to[{k}]", p)]
        rates: Any = [()] * len(ways) if self.rates is None else self.rates[:, None]
        found = [self.direct(way, *rate) for way, rate in zip(ways, rates, strict=True)]
        self.tangent.linear.clear()
        columns = np.stack([one for one, _ in found], axis=-1)
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        *values, state = np.split(columns, ends)
        values = [v.reshape(*shape, len(ways)) for v, shape in zip(values, shapes, strict=True)]
        du = np.stack([one for _, one in found])
        return Sensitivity(values, du, self.notes, self.to, state.T, self.u)

    def ways(self, name: str, p: Any) -> Iterator[Way]:
        """Directions of a parameter."""
        problem, comm = self.problem, self.problem.comm
        target: Any = None
        e: Any
        thing, e = p if isinstance(p, tuple) and len(p) == 2 else (p, None)
        of, moves = e if isinstance(e, str) else "", thing is problem.V.mesh
        if of:
            target, e = getattr(thing, of, None), None
        elif isinstance(thing, fem.Constant):
            target = thing.value
        elif isinstance(thing, fem.Function):
            target = thing.x.array
        elif moves and isinstance(e, fem.Function):
            target, cells = thing.geometry.x, thing.geometry.dofmap
            w, e = e.x.array.reshape(-1, problem.d), np.zeros_like(target)
            e[cells, : problem.d] = w[problem.V.dofmap.list[:, : cells.shape[1]]]
        base = check(name, target, FINITE, PARAMETER).copy()
        every = [e.x.array if isinstance(e, fem.Function) else e]

        def put(e: Floats, h: float) -> None:
            self.moves, value = moves and h != 0.0, base + h * e if h else base
            if of:
                setattr(thing, of, value[()])
            else:
                target[...] = value

        if e is None:
            number, total = np.arange(base.size), base.size
            if isinstance(thing, fem.Function):
                dofs, size = thing.function_space.dofmap, thing.function_space.dofmap.index_map_bs
                nodes = dofs.index_map.local_to_global(number[: total // size].astype(np.int32))
                number = (size * nodes[:, None] + np.arange(size)).ravel()
                total = size * dofs.index_map.size_global
            every = [1.0 * (number == g).reshape(base.shape) for g in range(total)]
        for one in every:
            size = problem.system.facet_length if moves else largest(comm, np.where(one, base, 0.0))
            yield partial(put, one), ratio(size, largest(comm, one))
