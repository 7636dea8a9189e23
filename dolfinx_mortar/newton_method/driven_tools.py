# SPDX-License-Identifier: MIT
"""Bolts, rigid sides and tools driven by forces: scalar unknowns of the QPs, see `qp.scalars`.

The motions e_a (in the frames of the nodes) of the unknowns q_a move bounds and slips,

    w_n <= g + e_n.q,    slip = slip_0 + w_t - e_t.q.

Nodes of a rigid side or of a bolt's cut follow, w = w_0 + e.q, and are eliminated: z = r^ - K^ y
there. The arms of moments turn with the side, e = e_0 + De q, with the reactions z_0 of the iterate
in De q.z_0. A step t q moves its nodes on arcs, not to u_0 + t e.q.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import (
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    SAME,
    TINY,
    Bools,
    Floats,
    Ints,
)
from dolfinx_mortar.interfaces.coupling import relative_motions
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.pretension import Bolt
from dolfinx_mortar.interfaces.tool import Driven
from dolfinx_mortar.newton_method.contacts import Contacts, Residuals
from dolfinx_mortar.newton_method.failures import StepFailed
from dolfinx_mortar.newton_method.linearisation import (
    Balance,
    Linearisation,
    to_displacement,
    to_reduced,
)
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import QPSolution, Scalars, moved

DISTINCT = 0.5
"""Share of nodes that a motion closes or opens, for a message: -1, or 0 to 0.24 in the tests."""


@dataclass(frozen=True)
class Settled:
    """A QP in which the tools are in equilibrium with their loads."""

    lin: Linearisation
    solved: QPSolution
    travel: Floats  # (m,) q
    drives: Drives

    def curve(self, t: float) -> Floats:
        """Difference (n,) between rotations of rigid sides and their motions t e.q."""
        return self.drives.curve(t * self.travel)


@dataclass(frozen=True)
class Drives:
    """Unknown motions of all driven tools at an iterate."""

    tools: list[tuple[Interface, Driven]]
    motions: Floats  # e, of the owned unknowns of y
    loads: Floats  # (m,) F
    reach: Floats  # (m,) largest motion of a slave node by each
    held: Ints  # (k,) owned unknowns of y that follow rigid sides and bolts
    follows: Bools  # motions of rigid sides and bolts
    sides: Bools  # motions of rigid sides
    moved: Callable[[Floats], Floats]  # q (m,) -> e (m, n), to first order
    curve: Callable[[Floats], Floats]  # q (m,) -> rotations minus e.q (n,)
    product: Callable[[PETSc.Vec], PETSc.Vec]  # y -> K^ y; collective
    comm: MPI.Comm

    def move(self, travel: Floats) -> None:
        """Move the tools by q (m,)."""
        first = 0
        for _, tool in self.tools:
            end = first + len(tool.names)
            tool.move(travel[first:end])
            first = end

    def missing(self, reactions: Floats) -> tuple[Floats, Floats]:
        """Residuals F + e.z (m,) for reactions z (n,), and sizes of terms; collective."""
        parts = self.motions * reactions
        sums = np.stack([parts.sum(axis=1), np.abs(parts).sum(axis=1)])
        total, size = self.comm.allreduce(sums, op=MPI.SUM)
        size = np.maximum(size, np.abs(self.loads))
        if (on := self.sides).any():  # each force is as accurate as the largest
            arms = np.maximum(self.arms(), TINY)
            size[on] = (size[on] / arms[on]).max() * arms[on]
        return self.loads + total, size

    def noise(self, balance: Balance) -> Floats:
        """Round-off (m,) of the reactions; collective."""
        return np.asarray(ROUND_OFF * balance.elements * self.arms())

    def arms(self) -> Floats:
        """Largest motion (m,) of a node by each unknown; collective."""
        return maximum(self.comm, *np.abs(self.motions).max(axis=1, initial=0.0))

    def allowed(self, force: float) -> Floats:
        """Tolerances (m,) of loads on rigid sides and bolts; collective."""
        on = self.sides | (self.follows & (self.loads == 0.0))
        return np.where(on, force * self.arms(), 0.0)

    def check_gaps(self, balance: Balance, active: Bools, facet_length: float) -> None:
        """Raise a StepFailed if an open gap separates a body from a loaded tool; collective.

        With inertia a load would move tools, which have no mass, across it instantaneously. Gaps of
        the mesh are below h / 8: h^2 / (8 R) at a tool of radius R >= h, the facet length.
        """
        loaded, first = np.abs(self.loads) > self.noise(balance), 0
        left = np.where(active[balance.nodes], 0.0, balance.bounds.upper)
        for owner, tool in self.tools:
            end = first + len(tool.names)
            on = self.motions[first:end, balance.bounds.dofs].any(axis=0)
            gap = float(self.comm.allreduce(left[on].min(initial=np.inf), op=MPI.MIN))
            if loaded[first:end].any() and not tool.holds and facet_length / 8.0 < gap < np.inf:
                raise StepFailed(
                    f"{owner!r} has a load and is {gap:.3g} from the body. With inertia, let tools "
                    "touch the body at the start: tools have no mass, so that forces move them "
                    "across a gap instantaneously. Prescribe the position until it touches, or "
                    "mesh the tool as a body with mass"
                )
            first = end


def find_drives(problem: ContactProblem, known: Floats | None = None) -> Drives | None:
    """Motions of the driven tools in the present geometry, None for none; collective.

    A slave node moves by sum_l D_jl e_l / D_jj. Reactions `known` (owned nodes, d) act like loads.
    """
    offered = [(link, link.interface.driven()) for link in problem.system.links]
    parts = [(link, tool) for link, tool in offered if tool is not None]
    if not parts:
        return None
    x = problem.X if problem.configuration is None else problem.positions().array_r
    x = x.reshape(problem.X.shape)
    counts = [len(tool.names) for _, tool in parts]
    ends = np.cumsum(counts)[:-1]

    def moved(travel: Floats) -> Floats:
        e = np.zeros((len(travel), problem.n, problem.d))
        for (link, tool), own, q in zip(
            parts, np.split(e, ends), np.split(travel, ends), strict=True
        ):
            ways = tool.motions(x[link.nodes], problem.X[link.nodes], q)
            own[:, link.nodes] = [link.relative(link.spread(way)) for way in ways]
            own[:, link.nodes] *= link.constrained
        return e.reshape(len(travel), -1)

    def curve(travel: Floats) -> Floats:
        beside = np.zeros((problem.n, problem.d))
        for (link, tool), q in zip(parts, np.split(travel, ends), strict=True):
            if tool.holds:
                beside[link.nodes] += tool.curve(problem.X[link.nodes], q) * link.constrained
        return beside.ravel()

    def product(y: PETSc.Vec) -> PETSc.Vec:
        T = problem.system.transformation
        return to_reduced(T, problem.K * to_displacement(T, y))

    loads, none = _loads(problem, parts, x, known), np.zeros(sum(counts))
    motions, whole = moved(none), [_ways(problem, *part, x) for part in parts]
    lengths = [np.linalg.norm(ways, axis=2).max(axis=1, initial=0.0) for ways in whole]
    reach = maximum(problem.comm, *np.concatenate(lengths))
    arms = maximum(problem.comm, *np.abs(motions).max(axis=1, initial=0.0))
    for (link, tool), own in zip(parts, np.split(np.asarray(arms), ends), strict=True):
        if isinstance(tool, Bolt):
            tool.check(link.sides, float(own.max()))
    held = [_unknowns(link, problem.d) for link, tool in parts if tool.holds]
    return Drives(
        tools=[(link.interface, tool) for link, tool in parts],
        motions=motions,
        loads=loads,
        reach=np.where(reach > 0.0, reach, 1.0),
        held=np.concatenate([np.zeros(0, dtype=np.int32), *held]),
        follows=np.repeat([tool.holds for _, tool in parts], counts),
        sides=np.repeat([tool.holds and not isinstance(tool, Bolt) for _, tool in parts], counts),
        moved=moved,
        curve=curve,
        product=product,
        comm=problem.comm,
    )


def _ways(problem: ContactProblem, link: Link, tool: Driven, x: Floats) -> Floats:
    return tool.motions(x[link.nodes], problem.X[link.nodes], np.zeros(len(tool.names)))


def _loads(
    problem: ContactProblem,
    parts: Sequence[tuple[Link, Driven]],
    x: Floats,
    known: Floats | None,
) -> Floats:
    """Loads (m,), with the work of given reactions; collective."""
    loads = np.concatenate([tool.loads() for _, tool in parts])
    if known is None:
        return loads
    given = []
    for link, tool in parts:
        acting = np.where(link.constrained[:, :1], known[link.nodes], 0.0)
        for way in _ways(problem, link, tool, x):
            mean = relative_motions(link, link.spread(way))[0]
            given.append(float((mean * acting).sum()))
    return np.asarray(loads + problem.comm.allreduce(np.array(given), op=MPI.SUM))


def _unknowns(link: Link, d: int) -> Ints:
    node, axis = np.nonzero(link.constrained)
    return (d * link.nodes[node] + axis).astype(np.int32)


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
        before, parts = lin.balance.reduced.array_r, np.zeros((m, m + 1))
        turned = np.stack([drives.moved(unit) for unit in np.eye(m)]) - drives.motions
        scale = lin.qp.diagonal.array_r[held]
        for a in np.flatnonzero(drives.follows):
            side, vector = drives.motions[a, held], lin.qp.b.duplicate()
            vector.array[held] = side
            product = drives.product(vector).array_r
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


def settle(drives: Drives, lin: Linearisation, solved: QPSolution, extent: float) -> Settled:
    """Solution of a QP, with the tools moved, in a model of size `extent`; collective.

    Raises:
        StepFailed: if hardly anything resists a load.
    """
    assert solved.travel is not None and solved.resistance is not None and lin.qp.scalars
    scale = drives.reach
    q = solved.travel / scale
    size = np.sqrt(lin.qp.scalars.sizes(lin.qp))
    values, vectors = np.linalg.eig(solved.resistance / np.outer(size, size))
    least = int(np.argmin(np.abs(values)))
    if drives.follows.all() and np.abs(values[least]) <= SAME:
        weakest = np.abs(vectors[:, least])
        raise unresisted(drives, lin, np.asarray(weakest == weakest.max()))
    if not QUARTER_OF_DIGITS * np.abs(solved.travel).max() <= extent:  # a body is free
        raise unresisted(drives, lin, np.abs(solved.travel))
    equal, held = lin.balance.equal, np.zeros(len(solved.x.array_r))
    held[drives.held] = (q @ drives.motions)[drives.held]
    values = equal.upper + held[equal.dofs]
    solved.x.array[equal.dofs] = values
    balance = replace(lin.balance, equal=replace(equal, lower=values, upper=values))
    return Settled(
        replace(lin, qp=moved(lin.qp, solved.travel), balance=balance), solved, q, drives
    )


def _names(drives: Drives) -> list[tuple[str, Interface, Driven]]:
    return [(name, owner, tool) for owner, tool in drives.tools for name in tool.names]


def unresisted(drives: Drives, lin: Linearisation, which: Floats) -> StepFailed:
    """Error that names the load of largest `which`; collective."""
    k = int(np.argmax(which))
    name, owner, tool = _names(drives)[k]
    if tool.holds:
        held = "hold the body against it, or prescribe the position"
        remedy = tool.remedy if isinstance(tool, Bolt) else held
        return StepFailed(
            f"nothing resists the load {name!r} = {drives.loads[k]:g} on {owner!r}: {remedy}"
        )
    closing = -np.sign(drives.loads[k]) * drives.motions[k][lin.balance.bounds.dofs]
    sums = drives.comm.allreduce(np.array([closing.sum(), np.abs(closing).sum()]))
    if "moment" in name:
        remedy = "a tool that is round about that axis turns freely without friction; leave it out"
    elif sums[0] < -DISTINCT * sums[1]:
        slides = ", or give friction if it slides" if lin.qp.friction is None else ""
        remedy = f"the force on a tool has to press it on the body; change its sign{slides}"
    elif lin.qp.friction is None:
        remedy = f"along {name} the side carries nothing without friction; give friction"
    else:
        remedy = (
            f"along {name} friction carries a load up to its limit only, where another force "
            "presses the tool on the body; give that force in an earlier step"
        )
    return StepFailed(
        f"nothing resists the load {name!r} = {drives.loads[k]:g} on {owner!r}: {remedy}, or "
        "prescribe the position"
    )


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
