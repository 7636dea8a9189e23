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
from itertools import count
from typing import Any

import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, largest, norm, ratio
from dolfinx_mortar.common.arguments import FINITE, Rule, array, check
from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, QUARTER_OF_DIGITS, SAME, Floats
from dolfinx_mortar.common.compat import cell_nodes
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.persistence.committed import Before
from dolfinx_mortar.problem.checks import StepData, check_problem
from dolfinx_mortar.problem.contacts import Contacts
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

LIST = Rule[Any]("give a list", lambda v: v if isinstance(v, list | tuple) and v else None)
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
    before, K = Before(problem.state, problem.outcome), problem.K.copy()
    problem.linear = copy(problem.linear)
    problem.linear.abandon()
    try:
        with system.put_back():
            try:
                return step.solve()
            finally:
                vars(problem).update(parts)
                K.copy(problem.K)
                problem.undo(before)
    finally:
        problem.terms.begin(problem.committed.level, step.level)
        problem.solid.follow()


class _Tangent:
    """The QP of the converged step, and its active set."""

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
        self.problem, self.qp, self.linear = problem, qp, copy(problem.linear)
        self.linear.abandon()
        self.linear.set_matrix(qp.A, definite=qp.definite, near=qp.near)
        self.T = problem.system.transformation if lin.geometry is None else lin.geometry.trial
        on = contacts.active[balance.nodes]
        self.state = State.create(qp, on.astype(np.int8), contacts.directions(limits))
        if (law := qp.friction) is not None:
            kappa = np.asarray(contacts.kappa(limits))
            kappa = np.where(law.across & np.isfinite(kappa), kappa, self.state.stiffness)
            self.state = replace(self.state, stiffness=kappa)
        z, gap = contacts.reactions(balance), np.abs(bounds.upper) * lin.diagonal.array[bounds.dofs]
        weak = np.where(on, z, gap) <= QUARTER_OF_DIGITS * largest(problem.comm, z)
        self.weak = problem.comm.allreduce(int(weak.sum()))

    def solve(self, balance: Balance) -> tuple[Floats, Floats]:
        """Correction of u (n,), and tractions (1 + d, nodes)."""
        problem, b, upper = self.problem, balance.reduced.copy(), self.qp.upper.copy()
        bounds, equal, limits = balance.bounds, balance.equal, balance.limits
        b.array[equal.dofs], upper.array[bounds.dofs] = 0.0, bounds.upper
        law, t = self.qp.friction, np.zeros((1 + problem.d, problem.n))
        if law is not None and limits is not None:
            mu, cohesion = limits.left
            law = replace(law, rest=-limits.slip, coefficient=mu, cohesion=cohesion)
        qp = replace(self.qp, b=b, upper=upper, friction=law)
        held = HeldProblem(qp, self.linear, problem.vector(), EPS)
        held.solve(self.state, TIGHT)
        z = held.z.array_r
        on = self.state.active > 0
        t[0, balance.nodes[on]] = z[bounds.dofs[on]] / bounds.weight[on]
        if law is not None and limits is not None:
            acts = self.state.slips(law)[:, None] | self.state.sticks(law)
            found = limits.vectors(np.where(acts, law.pick(z), 0.0)) + limits.known(t[0])
            t[1:, limits.nodes] = (found / limits.weight[:, None]).T
        held.x.array[equal.dofs] = equal.upper
        return np.array(to_displacement(self.T, held.x).array), t


class _Step:
    """A converged step, and what is beside it."""

    def __init__(self, problem: ContactProblem, of: Sequence[Any], to: Any) -> None:
        remembers = bool(problem.solid.state) or problem.system.has_friction
        chain, outcome = isinstance(to, Sensitivity), problem.ended_here()
        last = to if chain and remembers else None
        committed, interfaces, at = problem.committed, problem.interfaces, problem.owned_u
        off, gone = any_rank(
            problem.comm,
            not (committed.begun and np.array_equal(committed.displacement, at)),
            last is not None and not np.array_equal(last.at, committed.displacement),
        )
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
        self.whole = problem.X, problem.system
        self.to = check("to", to.to if chain else to, LIST)
        self.of = [check(f"of[{k}]", q, QUANTITY) for k, q in enumerate(check("of", of, LIST))]
        ended = outcome or committed
        self.level = committed.level if ended.level is None else ended.level
        parts = [f.x.array for f in problem.solid.state.values()]
        parts += [] if committed.sliding is None else [committed.sliding]
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
        problem.X, problem.system = self.whole
        if self.moves:
            problem.X = problem.V.tabulate_dof_coordinates()[: problem.n, : problem.d]
            weight = None if kinematics.unweighted else kinematics.weights_at
            given = problem.interfaces, problem.supports.fixed, weight
            problem.system = InterfaceSystem(problem.V, *given)
        data = problem.begin_step(self.level)
        problem.move(self.at)
        problem.follow_geometry()
        return data, find_balance(problem, data, 0.0, self.contacts.multipliers)

    def corrected(self) -> Floats:
        """Correction of u, and tractions."""
        return np.concatenate([v.ravel() for v in self.tangent.solve(self.balance()[1])])

    def results(self) -> Floats:
        """Quantities, and the state at the end of the step."""
        problem, (_, balance), committed = self.problem, self.balance(), self.problem.committed
        contacts = self.contacts.completed(balance.limits)
        slips, _ = set_results(problem, balance, contacts)
        committed.supports = support_forces(problem, balance)
        problem.solid.evaluate()
        ends = [f.x.array for f in problem.solid.points.staged.values()]
        ends += [] if contacts.sliding is None else [contacts.sliding]
        totals = slips or committed
        parts = [*(q() for q in self.of), *ends, self.at, totals.slid, totals.dissipated]
        return np.concatenate([np.ravel(part) for part in parts])

    def direct(self, way: Way, *rates: Any) -> tuple[Floats, Floats]:
        """Derivatives of results and u."""
        comm, n, h, last = self.problem.comm, len(self.u), STEP * (way[1] or 1.0), np.inf
        u, t = norm(comm, self.u), norm(comm, self.tractions.ravel())
        du: Floats = np.zeros(n)
        dt = 0.0 * self.tractions
        for k in count():
            found = self.differ(self.corrected, h, way, du, dt, *rates)
            du, dt = du + found[:n], found[n:].reshape(dt.shape)
            sizes = norm(comm, du), norm(comm, dt.ravel())
            effect = h * max(ratio(sizes[0], u), ratio(sizes[1], t))
            if k == 0 and 0.0 < effect < np.inf:
                h *= (STEP / effect) ** (1 / 3 if way[1] else 1)
            left = ratio(norm(comm, found[:n]), max(sizes[0], QUARTER_OF_DIGITS * STEP * u / h))
            error, stays, last = left * min(ratio(left, last), 1.0), left > 0.5 * last, left
            if k > 1 and (error <= HALF_OF_DIGITS or stays):
                break
        if error > STEP:
            self.notes.append(f"derivatives are accurate to {error:.1e} only")
        if effect <= SAME and not self.reads(way):
            raise ValueError("to: nothing reads one of the parameters; leave it out")
        return self.differ(self.results, h, way, du, dt, *rates), du

    def reads(self, way: Way) -> bool:
        """Whether NaN or zero makes a difference or an error."""
        comm, base = self.problem.comm, np.append(self.corrected(), self.results())
        for h in (np.nan, -way[1]):
            try:
                way[0](h)
                changed = base if self.moves else np.append(self.corrected(), self.results()) - base
                if not norm(comm, changed) <= SAME * norm(comm, base):
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
        off, t = np.split(self.corrected(), [len(self.u)])
        for missed, all_ in ((off, self.u), (t - self.tractions.ravel(), t)):
            if ratio(norm(comm, missed), norm(comm, all_)) > CONVERGED:
                raise ValueError(
                    "problem: u does not solve it with the present data: call newton() again"
                )
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
            target, cells = thing.geometry.x, cell_nodes(thing)
            w, e = e.x.array.reshape(-1, problem.d), np.zeros_like(target)
            e[cells, : problem.d] = w[problem.V.dofmap.list[:, : cells.shape[1]]]
        base = check(name, target, FINITE, PARAMETER).copy()
        if moves and problem.solid.forms.dilatation is not None:
            raise ValueError(f"{name} are coordinates: mean dilatation has no derivative by them")

        def put(e: Floats, h: float) -> None:
            self.moves, value = moves and h != 0.0, base + h * e if h else base
            if of:
                setattr(thing, of, value[()])
            else:
                target[...] = value

        every = _units(thing, base)
        if e is not None:
            e = e.x.array if isinstance(e, fem.Function) else e
            remedy = f"give a direction of shape {base.shape} that is not zero"
            some = array(base.shape, remedy=remedy, holds=lambda e: any_rank(comm, e.any())[0])
            every = iter([check(name, e, some)])
        for one in every:
            size = problem.system.facet_length if moves else largest(comm, np.where(one, base, 0.0))
            yield partial(put, one), ratio(size, largest(comm, one))


def _units(thing: Any, base: Floats) -> Iterator[Floats]:
    """Unit vectors of the components, of Functions of all ranks."""
    number, total = np.arange(base.size), base.size
    if isinstance(thing, fem.Function):
        dofs, size = thing.function_space.dofmap, thing.function_space.dofmap.index_map_bs
        nodes = dofs.index_map.local_to_global(number[: total // size].astype(np.int32))
        number = (size * nodes[:, None] + np.arange(size)).ravel()
        total = size * dofs.index_map.size_global
    return (1.0 * (number == k).reshape(base.shape) for k in range(total))
