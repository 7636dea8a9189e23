# SPDX-License-Identifier: MIT
"""Derivatives of a converged step by parameters (docs/guide/sensitivities.md).

With its active set a step satisfies f(u, t; p, s) = 0, f = T^T (r - B^T t), and w = 0: gaps of closed
nodes, slips of sticking ones, the law of slipping ones, Dirichlet data, ties; t are the tractions, s
is the committed state. Central differences give f' and w' along p, s, u and t, without a solve.
K^ y = f' with y = w' at held unknowns corrects u' and t' by the exact tangent until both vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.parallel import any_rank, largest, norm, ratio
from dolfinx_mortar.common.arguments import Rule, check, instance
from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, QUARTER_OF_DIGITS, SAME, TINY, Floats
from dolfinx_mortar.interfaces.constraints import SlipLimits
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.persistence.committed import Before
from dolfinx_mortar.problem.checks import StepData, check_problem
from dolfinx_mortar.problem.contacts import Contacts, contact_forces, largest_force
from dolfinx_mortar.problem.linearisation import Balance, find_balance, linearise
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp.held import TIGHT, HeldProblem, State
from dolfinx_mortar.report.certificate import set_results
from dolfinx_mortar.report.reaction import support_forces

STEP = EPS ** (1 / 3)  # relative, of central differences
CONVERGED = 1e-5  # largest relative residual of a step


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of quantities by parameters, see `sensitivity`.

    Attributes:
        values: for quantity i and parameter k ``values[i][k]``, an array of the shape of the
            quantity and then that of the parameter.
        du: of each component of the parameters the derivative (n,) of the owned displacements.
        notes: where derivatives are one-sided or inaccurate.
        to: the parameters.
        at: (n,) owned displacements of the step.
        history: of each component the derivatives of the state at the end of the step.
    """

    values: list[list[Floats]]
    du: list[Floats]
    notes: list[str]
    to: Sequence[Any]
    at: Floats
    history: list[list[Floats]]


Way = tuple[Callable[[float], None], float]  # what sets p + h e, and |p| / |e|


def sensitivity(problem: ContactProblem, *, of: Sequence[Any], to: Any) -> Sensitivity:
    """Derivatives of quantities by parameters in a converged step; collective.

        found = dm.sensitivity(problem, of=[lambda: contact.force[1]], to=[E, nu])
        found.values[0][1]  # d force / d nu

    The active set stays. One linear solve for each component of the parameters; all is restored to
    the last bit.

    Args:
        problem: after ``newton``, with internal variables or friction before ``commit``.
        of: functions without arguments that return a number or an array of results, the same on
            all ranks, and functionals of ``solid.u`` in UFL, which have no weight but their own.
        to: Constants, Functions (by each global dof), pairs (Constant or Function, direction) with
            an array or Function, (mesh, direction) of the nodal coordinates with a Function on V,
            (object, name) of a number, such as (sphere, "radius"). Or the result of the last step,
            whose derivatives of the committed state count, too.

    Raises:
        ValueError: before a converged step, or if data have changed since; for parameters that
            nothing reads; for loads of tools and bolts, inertia, a history without its
            derivatives.
    """
    check_problem(problem, ContactProblem)
    check_owned(problem.interfaces, problem.supports)
    step = _Step(problem, of, to)
    before, parts, system = Before(problem.state, problem.outcome), vars(problem).copy(), problem.system
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
        problem.linear.clear()


class _Step:
    """A converged step, and what is beside it."""

    def __init__(self, problem: ContactProblem, of: Sequence[Any], to: Any) -> None:
        last, outcome = to if isinstance(to, Sensitivity) else None, problem.ended_here()
        committed, interfaces = problem.committed, problem.interfaces
        remembers, begun = bool(problem.solid.state) or problem.system.has_friction, committed.begun
        at, laws = committed.displacement, [i for i in interfaces if i.law is not None]
        off, gone = any_rank(
            problem.comm,
            not np.array_equal(at, problem.owned_u),
            last is not None and not np.array_equal(last.at, at),
        )
        for why, wrong in {
            "there is no converged step: call newton(problem) first": not outcome and (off or not begun),
            "the step is committed, and has a history: call it before commit()": remembers and not outcome,
            "the committed state has a history: give as to= the result of the last step": (
                remembers and begun and last is None
            ),
            "to= is the result of another step than the last one": gone,
            "friction on tools is possible in the first step only": begun and any(i.tool for i in laws),
            "loads drive a tool, rigid side or bolt": any(i.driven() is not None for i in interfaces),
            "inertia or a term has a state": problem.in_time
            or any(t.state for _, t in problem.terms.named),
        }.items():
            if wrong:
                raise ValueError(f"problem: no derivatives here, as {why}")
        self.problem, self.notes, self.to = problem, list[str](), to if last is None else last.to
        self.of = [check(f"of[{k}]", q, QUANTITY) for k, q in enumerate(of)]
        self.level = committed.level if outcome is None or outcome.level is None else outcome.level
        self.u, self.moves = problem.owned_u.copy(), False
        self.past = [f.x.array for f in problem.solid.state.values()]
        self.past += [committed.displacement, committed.slid, committed.dissipated]
        self.began = [values.copy() for values in self.past]
        self.history = None if last is None else last.history
        self.tractions: Floats = np.zeros((1 + problem.d, problem.n))
        for link in problem.system.unilateral:
            on, law = link.nodes[link.constrained[:, 0]], link.interface.law
            self.tractions[0, link.nodes] += link.constrained[:, 0] * link.interface.multiplier
            if law is not None:
                t = link.interface.nodal["traction"].x.array
                self.tractions[1:, on] = -t.reshape(-1, problem.d)[on].T
        ended = outcome or committed
        self.base = Contacts(ended.active, np.zeros(0), sliding=ended.sliding)
        self.put(0.0)

    def put(self, h: float, du: Any = 0.0, dt: Any = 0.0, rates: Any = None) -> None:
        """Move state, u and tractions."""
        rates = rates or [0.0] * len(self.past)
        for now, kept, rate in zip(self.past, self.began, rates, strict=True):
            now[...] = kept + h * rate
        self.at = self.u + h * du
        normal, *others = self.tractions + h * dt
        self.contacts = replace(self.base, multipliers=normal, tangential=np.transpose(others))

    def differ(
        self, evaluate: Callable[[], Floats], h: float, way: Way, *along: Any
    ) -> Floats:
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
        return (found[0] - found[1]) / (2.0 * h)

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
        """f and w (2, n)."""
        (_, balance), contacts, found = self.balance(), self.contacts, np.zeros((2, len(self.u)))
        for part in (balance.equal, balance.bounds):
            found[1, part.dofs] = part.upper
        if (limits := balance.limits) is not None:
            t = limits.along(contacts.tangential[limits.nodes])
            tangential, (mu, cohesion) = 0.0 * contacts.tangential, limits.left
            tangential[limits.nodes] = limits.vectors(t)
            contacts = replace(contacts, tangential=tangential)
            most = mu * contacts.multipliers[limits.nodes] + cohesion / limits.weight
            law = self.limits.weight[:, None] * (most[:, None] * self.directions(limits) - t)
            w = np.where(self.slips, law, -limits.slip)
            found[1, limits.tangential[limits.some]] = w[limits.some]
        f = balance.r.array_r - contact_forces(self.problem, contacts).sum(axis=0).ravel()
        found[0] = self.times(f, self.C, "multTranspose")
        found[1, ~self.bound] = 0.0
        return found

    def directions(self, limits: SlipLimits) -> Floats:
        """Directions of slip (m, t)."""
        size = np.linalg.norm(limits.slip, axis=1, keepdims=True)
        turns = limits.some.all(axis=1, keepdims=True) & (limits.some.shape[1] > 1) & (size > 0.0)
        unit = limits.slip / np.where(turns, size, 1.0)
        return np.where(turns, unit, self.base.directions(limits))

    def times(self, v: Floats, C: Any, method: str = "mult") -> Floats:
        """(I + C) v, or the transpose."""
        if C is None:
            return v
        x = self.problem.vector(v)
        y = x.duplicate()
        getattr(C, method)(x, y)
        return np.asarray(v + y.array)

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

    def linearise(self) -> None:
        problem, system, base = self.problem, self.problem.system, self.contacts
        data, balance = self.balance()
        moving = problem.configuration is not None and system.unilateral
        given = base.multipliers, base.tangential if data.limits else None, data.partners
        lin = linearise(problem, balance, moving=given if moving else None)
        T = system.transformation
        self.C = self.G = None if T is None else T.change
        if lin.geometry is not None:
            self.G = lin.geometry.trial.change
        qp, bounds, limits = replace(lin.qp, extent=0.0), balance.bounds, balance.limits
        if qp.product is not None:
            qp = replace(qp, A=qp.A.duplicate(copy=True), product=None)
        problem.linear.set_matrix(qp.A, definite=qp.definite, near=qp.near)
        on = base.active[balance.nodes]
        known = base.directions(limits), base.kappa(limits)
        self.qp, self.state = qp, State.create(qp, on.astype(np.int8), *known)
        self.bound: Any = np.zeros(len(self.u), dtype=bool)
        self.bound[balance.equal.dofs] = self.bound[bounds.dofs[on]] = True
        self.equal, self.limits, free = balance.equal.dofs, limits, ~self.bound
        self.normal, self.nodes, self.D = bounds.dofs[on], balance.nodes[on], bounds.weight[on]
        if (law := qp.friction) is not None:
            self.slips = self.state.slips(law)[:, None] & law.some
            self.acts = law.acts(on[law.normal])[:, None] & law.some
            self.bound[law.tangential[self.acts]] = True
            free &= ~self.bound
        self.scale = np.where(self.bound, abs(lin.diagonal.array), 1.0)
        if law is not None:
            self.scale[law.tangential[self.slips]] = 1.0
        self.force = largest_force(problem.comm, balance, base.reactions(balance))
        f, w = self.residual()
        if self.size(f * free, w) > CONVERGED:
            raise ValueError("problem: u is no solution for the present data: solve the step again, newton(problem)")
        z, gap = base.reactions(balance), abs(bounds.upper) * lin.diagonal.array[bounds.dofs]
        weak = np.where(on, z, gap) < QUARTER_OF_DIGITS * largest(problem.comm, z)
        if count := problem.comm.allreduce(int(weak.sum())):
            self.notes.append(f"{count} nodes are about to open or close: derivatives are one-sided")

    def size(self, f: Floats, w: Floats) -> float:
        """Relative size."""
        return ratio(norm(self.problem.comm, f, w * self.scale), self.force)

    def solve_linear(self, f: Floats, w: Floats) -> tuple[Floats, Floats]:
        """y and the change of tractions."""
        problem, qp, x = self.problem, self.qp, self.problem.vector()
        b, upper, law = f.copy(), qp.upper.copy(), qp.friction
        b[self.equal] = 0.0
        upper.array[self.normal] = w[self.normal]
        if law is not None:
            w_t = law.pick(w)
            law.put(b, law.pick(b) + np.where(self.slips, w_t, 0.0))
            acting = TINY * (law.cohesion > 0.0)
            law = replace(law, rest=np.where(self.slips, 0.0, w_t), cohesion=acting)
        qp = replace(qp, b=problem.vector(b), upper=upper, friction=law)
        held = HeldProblem(qp, problem.linear, x, SAME)
        held.solve(self.state, TIGHT)
        z, dt = held.z.array_r, np.zeros(self.tractions.shape)
        dt[0, self.nodes] = z[self.normal] / self.D
        if law is not None:
            t = np.where(self.acts, law.pick(z) - np.where(self.slips, w_t, 0.0), 0.0)
            dt[1:, self.limits.nodes] = self.limits.vectors(t / self.limits.weight[:, None]).T
        y = x.array.copy()
        y[self.equal] = w[self.equal]
        return self.times(y, self.G), dt

    def direct(self, way: Way, rates: Any) -> tuple[Floats, Floats]:
        """Derivatives of results and u."""
        comm, u = self.problem.comm, norm(self.problem.comm, self.u)
        du, dt, left, h = 0.0 * self.u, 0.0 * self.tractions, np.inf, STEP * (way[1] or 1.0)
        found = self.differ(self.residual, h, way, du, dt, rates)
        if effect := h * self.size(*found):
            h *= (STEP / effect) ** (1 / 3 if way[1] else 1)
        while True:
            f, w = self.differ(self.residual, h, way, du, dt, rates)
            change, more = self.solve_linear(f, w)
            du, dt, last = du + change, dt + more, left
            size = max(norm(comm, du), QUARTER_OF_DIGITS * STEP * u / h)
            left = ratio(norm(comm, change), size)
            print("    left", left, h)
            if left <= HALF_OF_DIGITS or left > 0.5 * last:
                break
        if left > STEP:
            self.notes.append(f"derivatives are accurate to {left:.1e} only")
        return self.differ(self.results, h, way, du, dt, rates), du

    def solve(self) -> Sensitivity:
        problem = self.problem
        for k, q in enumerate(self.of):
            if isinstance(q, ufl.Form):
                self.of[k] = partial(_integral, problem, fem.form(q))
        shapes = [np.shape(q()) for q in self.of]
        own = [v.shape for v in self.past]
        self.linearise()
        every = [self.ways(k, p) for k, p in enumerate(self.to)]
        ways = [way for _, some in every for way in some]
        columns, rates, history = [], self.history or [None] * len(ways), []
        found = [self.direct(*both) for both in zip(ways, rates, strict=True)]
        ends = np.cumsum([int(np.prod(s)) for s in (*shapes, *own)])[:-1]
        columns = [np.split(one, ends) for one, _ in found]
        values = []
        for i, shape in enumerate(shapes):
            row, at = [], 0
            for of, some in every:
                row.append(np.stack([c[i] for c in columns[at : at + len(some)]], axis=-1).reshape(*shape, *of))
                at += len(some)
            values.append(row)
        history = [[v.reshape(s) for v, s in zip(c[len(shapes) :], own, strict=True)] for c in columns]
        return Sensitivity(values, [du for _, du in found], self.notes, self.to, self.u, history)

    def ways(self, k: int, p: Any) -> tuple[tuple[int, ...], list[Way]]:
        """Shape and directions of a parameter."""
        problem, comm = self.problem, self.problem.comm
        thing, e = p if isinstance(p, tuple) and len(p) == 2 else (p, None)
        name, moves = e if isinstance(e, str) else "", isinstance(thing, Mesh)
        target: Any = None
        if name:
            target, e = getattr(thing, name, None), None
        elif isinstance(thing, fem.Constant):
            target = thing.value
        elif isinstance(thing, fem.Function):
            target = thing.x.array
        elif moves and isinstance(e, fem.Function):
            target, cells = thing.geometry.x, thing.geometry.dofmap
            w, e = e.x.array.reshape(-1, problem.d), np.zeros_like(target)
            e[cells, : problem.d] = w[problem.V.dofmap.list[:, : cells.shape[1]]]
        e = e.x.array if isinstance(e, fem.Function) else e
        base: Floats = np.array(target, dtype=np.float64)

        def put(e: Floats, h: float) -> None:
            self.moves, value = moves and h != 0.0, base + h * e if h else base
            if name:
                setattr(thing, name, value[()])
            else:
                target[...] = value

        shape, every = (), [e]
        if e is None:
            shape, number = base.shape, np.arange(base.size)
            if isinstance(thing, fem.Function):
                dofs, size = thing.function_space.dofmap, thing.function_space.dofmap.index_map_bs
                nodes = dofs.index_map.local_to_global(number[: base.size // size].astype(np.int32))
                number = (size * nodes[:, None] + np.arange(size)).ravel()
                shape = (size * dofs.index_map.size_global,)
            every = [1.0 * (number == g).reshape(base.shape) for g in range(int(np.prod(shape)))]
        found = []
        for e in every:
            size = problem.system.facet_length if moves else largest(comm, np.where(e, base, 0.0))
            found.append((partial(put, e), ratio(size, largest(comm, e))))
        return shape, found


def _integral(problem: ContactProblem, form: fem.Form) -> float:
    return float(problem.comm.allreduce(fem.assemble_scalar(form)))


QUANTITY = Rule(
    "give a function without arguments, or a functional in UFL",
    lambda q: q if callable(q) or (isinstance(q, ufl.Form) and not q.arguments()) else None,
)
