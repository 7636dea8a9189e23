# SPDX-License-Identifier: MIT
"""Bolts, rigid sides and tools driven by forces: scalar unknowns of the QPs, see `qp.scalars`.

The motions e_a (in the frames of the nodes) of the unknowns q_a move bounds and slips,

    w_n <= g + e_n.q,    slip = slip_0 + w_t - e_t.q.

Nodes of a rigid side or of a bolt's cut follow, w = w_0 + e.q, and are eliminated: z = r^ - K^ y
there. The arms of moments turn with the side, e = e_0 + De q, with the reactions z_0 of the iterate
in De q.z_0. A step t q moves its nodes on arcs, not to u_0 + t e.q.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common.arrays import (
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    SAME,
    TINY,
    Bools,
    Floats,
)
from dolfinx_mortar.interfaces.coupling import relative_motions
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tie import Bolt
from dolfinx_mortar.problem.contacts import Contacts, Residuals
from dolfinx_mortar.problem.linearisation import (
    Balance,
    Linearisation,
    to_displacement,
    to_reduced,
)
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import QPSolution, Scalars, moved
from dolfinx_mortar.steps.failures import StepFailed


class Drives:
    """Unknown motions q (m,) of all driven tools at an iterate; collective.

    A slave node moves by sum_l D_jl e_l / D_jj.

    Attributes:
        motions: (m, n) e, of the owned unknowns of y.
        arms: (m,) largest motion of a node by each unknown.
        reach: (m,) largest motion of a point of the slave side by each.
        loads: (m,) F, with the work of given reactions.
        held: (k,) owned unknowns of y that follow rigid sides and bolts.
        follows: (m,) motions of rigid sides and bolts.
        sides: (m,) motions of rigid sides.
    """

    def __init__(
        self,
        problem: ContactProblem,
        tools: Sequence[tuple[Link, Any]],
        known: Floats | None = None,
    ) -> None:
        self.problem, self.tools, self.comm = problem, tools, problem.comm
        at = problem.X if problem.configuration is None else problem.positions().array_r
        self._x = at.reshape(problem.X.shape)
        counts = [len(tool.names) for _, tool in tools]
        self._ends, none = np.cumsum(counts)[:-1], np.zeros(sum(counts))
        self.motions = self.moved(none)
        self.arms = maximum(self.comm, *np.abs(self.motions).max(axis=1, initial=0.0))
        held, reach, works = [np.zeros(0, dtype=np.int32)], none.copy(), none.copy()
        for (link, tool), q, arm, far, work in self._each(none, self.arms, reach, works):
            if isinstance(tool, Bolt):
                tool.check(link.sides, float(arm.max()))
            if tool.holds:
                node, axis = np.nonzero(link.constrained)
                held.append((problem.d * link.nodes[node] + axis).astype(np.int32))
            ways = tool.motions(self._x[link.nodes], problem.X[link.nodes], q)
            far[:] = np.linalg.norm(ways, axis=2).max(axis=1, initial=0.0)
            if known is not None:
                acting = np.where(link.constrained[:, :1], known[link.nodes], 0.0)
                means = [relative_motions(link, link.spread(way))[0] for way in ways]
                work[:] = [(mean * acting).sum() for mean in means]
        longest = maximum(self.comm, *reach)
        self.reach = np.where(longest > 0.0, longest, 1.0)
        loads = np.concatenate([tool.loads() for _, tool in tools])
        self.loads: Floats = loads + self.comm.allreduce(works, op=MPI.SUM)
        self.held = np.concatenate(held)
        self.follows = np.repeat([tool.holds for _, tool in tools], counts)
        sides = [tool.holds and not isinstance(tool, Bolt) for _, tool in tools]
        self.sides = np.repeat(sides, counts)

    def _each(self, *values: Floats | Bools) -> Iterator[Any]:
        """Each tool with its parts of values (m, ..)."""
        return zip(self.tools, *(np.split(v, self._ends) for v in values), strict=True)

    def moved(self, travel: Floats) -> Floats:
        """Motions e (m, n), turned by q (m,), to first order; collective."""
        problem = self.problem
        e = np.zeros((len(travel), problem.n, problem.d))
        for (link, tool), own, q in self._each(e, travel):
            ways = tool.motions(self._x[link.nodes], problem.X[link.nodes], q)
            own[:, link.nodes] = [link.relative(link.spread(way)) for way in ways]
            own[:, link.nodes] *= link.constrained
        return e.reshape(len(travel), -1)

    def curve(self, travel: Floats) -> Floats:
        """Rotations of rigid sides by q (m,) minus e.q (n,)."""
        beside = np.zeros((self.problem.n, self.problem.d))
        for (link, tool), q in self._each(travel):
            if tool.holds:
                at = self.problem.X[link.nodes]
                beside[link.nodes] += tool.curve(at, q) * link.constrained
        return beside.ravel()

    def move(self, travel: Floats) -> None:
        """Move the tools by q (m,)."""
        for (_, tool), q in self._each(travel):
            tool.move(q)

    def missing(self, reactions: Floats) -> tuple[Floats, Floats]:
        """Residuals F + e.z (m,) for reactions z (n,), and sizes of terms; collective."""
        parts = self.motions * reactions
        sums = np.stack([parts.sum(axis=1), np.abs(parts).sum(axis=1)])
        total, size = self.comm.allreduce(sums, op=MPI.SUM)
        size = np.maximum(size, np.abs(self.loads))
        if (on := self.sides).any():  # each force is as accurate as the largest
            arms = np.maximum(self.arms, TINY)
            size[on] = (size[on] / arms[on]).max() * arms[on]
        return self.loads + total, size

    def noise(self, balance: Balance) -> Floats:
        """Round-off (m,) of the reactions."""
        return ROUND_OFF * balance.elements * self.arms

    def allowed(self, force: float) -> Floats:
        """Tolerances (m,) of loads on rigid sides and bolts."""
        on = self.sides | (self.follows & (self.loads == 0.0))
        return np.where(on, force * self.arms, 0.0)

    def check_gaps(self, balance: Balance, active: Bools, facet_length: float) -> None:
        """Raise a StepFailed if an open gap separates a body from a loaded tool; collective.

        With inertia a load would move tools, which have no mass, across it instantaneously. Gaps of
        the mesh are below h / 8: h^2 / (8 R) at a tool of radius R >= h, the facet length.
        """
        loaded = np.abs(self.loads) > self.noise(balance)
        left = np.where(active[balance.nodes], 0.0, balance.bounds.upper)
        for (link, tool), e, acts in self._each(self.motions, loaded):
            on = e[:, balance.bounds.dofs].any(axis=0)
            gap = float(self.comm.allreduce(left[on].min(initial=np.inf), op=MPI.MIN))
            if acts.any() and not tool.holds and facet_length / 8.0 < gap < np.inf:
                raise StepFailed(
                    f"{link.interface!r} has a load and is {gap:.3g} from the body. With inertia, "
                    "let tools touch the body at the start: tools have no mass, so that forces "
                    "move them across a gap instantaneously. Prescribe the position until it "
                    "touches, or mesh the tool as a body with mass"
                )


def find_drives(problem: ContactProblem, known: Floats | None = None) -> Drives | None:
    """Motions of the driven tools in the present geometry, None for none; collective.

    Reactions `known` (owned nodes, d) act like loads.
    """
    offered = [(link, link.interface.driven()) for link in problem.system.links]
    tools = [(link, tool) for link, tool in offered if tool is not None]
    return Drives(problem, tools, known) if tools else None


def as_scalars(drives: Drives, lin: Linearisation, rtol: float, begun: float) -> Scalars:
    """Motions as scalars of the QP of an iterate, scaled to lengths; collective.

    On rigid sides the reaction is r^ - K^ y, and arms turn. Tolerances are `rtol` times the forces
    on a tool, on rigid sides also times `begun`, the largest force at the start of the step.
    """
    e, held, equal = drives.motions.copy(), drives.held, lin.balance.equal
    m, inverse = len(e), 1.0 / drives.reach
    loads: Floats = drives.loads.copy()
    columns, rows = np.zeros_like(e), np.zeros_like(e)
    block: Floats = np.zeros((m, m))
    e[:, held] = 0.0
    if drives.follows.any():
        T = drives.problem.system.transformation
        before, parts = lin.balance.reduced.array_r, np.zeros((m, m + 1))
        turned = np.stack([drives.moved(unit) for unit in np.eye(m)]) - drives.motions
        scale = lin.qp.diagonal.array_r[held]
        for a in np.flatnonzero(drives.follows):
            side, vector = drives.motions[a, held], lin.qp.b.duplicate()
            vector.array[held] = side
            product = to_reduced(T, drives.problem.K * to_displacement(T, vector)).array_r
            parts[a, m] = side @ before[held] - product[equal.dofs] @ equal.upper
            parts[a, :m] = (
                drives.motions[:, held] @ product[held] - turned[:, a, held] @ before[held]
            )
            rows[a] = product
            rows[a, equal.dofs] = 0.0
            columns[a] = rows[a]
            columns[a, held] = -scale * side
        parts = drives.comm.allreduce(parts, op=MPI.SUM)
        loads, block = loads + parts[:, m], parts[:, :m]
    noise = drives.noise(lin.balance) + drives.allowed(rtol * begun) + rtol * np.abs(drives.loads)
    block = block * np.outer(inverse, inverse)
    each = inverse[:, None]
    forces = loads * inverse, columns * each, rows * each, block, noise * inverse
    return Scalars(e * each, *forces)


def settle(lin: Linearisation, solved: QPSolution, extent: float) -> tuple[Linearisation, Floats]:
    """QP and motions q (m,) in which tools balance their loads; `extent`: of the model; collective.

    Raises:
        StepFailed: if hardly anything resists a load.
    """
    drives = lin.drives
    assert solved.travel is not None and solved.resistance is not None and lin.qp.scalars
    scale = drives.reach
    q = solved.travel / scale
    size = np.sqrt(lin.qp.scalars.sizes(lin.qp))
    values, vectors = np.linalg.eig(solved.resistance / np.outer(size, size))
    least = int(np.argmin(np.abs(values)))
    if drives.follows.all() and np.abs(values[least]) <= SAME:
        weakest = np.abs(vectors[:, least])
        raise unresisted(lin, np.asarray(weakest == weakest.max()))
    if not QUARTER_OF_DIGITS * np.abs(solved.travel).max() <= extent:  # a body is free
        raise unresisted(lin, np.abs(solved.travel))
    equal, held = lin.balance.equal, np.zeros(len(solved.x.array_r))
    held[drives.held] = (q @ drives.motions)[drives.held]
    values = equal.upper + held[equal.dofs]
    solved.x.array[equal.dofs] = values
    balance = replace(lin.balance, equal=replace(equal, lower=values, upper=values))
    return replace(lin, qp=moved(lin.qp, solved.travel), balance=balance), q


def unresisted(lin: Linearisation, which: Floats) -> StepFailed:
    """Error that names the load of largest `which`; collective."""
    drives, k = lin.drives, int(np.argmax(which))
    names = [(name, link.interface, tool) for link, tool in drives.tools for name in tool.names]
    name, owner, tool = names[k]
    seen = f"nothing resists the load {name!r} = {drives.loads[k]:g} on {owner!r}: "
    if tool.holds:
        held = "hold the body against it, or prescribe the position"
        return StepFailed(seen + (tool.remedy if isinstance(tool, Bolt) else held))
    if "moment" in name:
        remedy = "a tool that is round about that axis turns freely without friction; leave it out"
    else:
        carries = "the side carries nothing without friction; give friction"
        if lin.qp.friction is not None:
            carries = (
                "friction carries a load up to its limit only, where another force presses the "
                "tool on the body; give that force in an earlier step"
            )
        pressed = "the force on a tool has to press it on the body; change its sign if it lifts"
        remedy = f"{pressed} it. If the tool slides, along {name} {carries}"
    return StepFailed(f"{seen}{remedy}, or prescribe the position")


def miss(
    problem: ContactProblem, balance: Balance, contacts: Contacts, residual: Residuals, rtol: float
) -> Residuals:
    """Residuals with the loads of bolts, tools and rigid sides; collective."""
    drives = find_drives(problem, balance.known(contacts.multipliers))
    if drives is None:
        return residual
    carried = np.zeros(drives.motions.shape[1])
    carried[balance.bounds.dofs] = contacts.reactions(balance)
    if (limits := balance.limits) is not None:
        carried[limits.tangential[limits.some]] = contacts.tangential_reactions(limits)[limits.some]
    carried[drives.held] = balance.reduced.array_r[drives.held]
    missing, size = drives.missing(carried)
    off, size = np.abs(missing), np.maximum(size, TINY)
    beyond = off - drives.noise(balance) - drives.allowed(residual.limit)
    excess = float((beyond / size).max()) / rtol
    return replace(residual, excess=max(residual.excess, excess), loads=float((off / size).max()))
