# SPDX-License-Identifier: MIT
r"""Tools driven by forces: their motion in a Newton step, so that each carries its load.

With the motions e_a (in the frames of the nodes) of the unknowns q_a of the tools, a QP with its
bounds and slips taken relative to the moved tools,

    w_n <= g + e_n.q,    slip = slip_0 + w_t - e_t.q,

has reactions z(q), and q solves the m equations F_a + e_a.z(q) = 0. Without friction these are the
derivatives of a convex function, piecewise linear in q: of one unknown they are solved by secants,
which begin with the diagonal of K^ at the closed nodes, of several by Newton's method with
differences. All QPs have one matrix, and its factorisation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import ROUND_OFF, Floats
from dolfinx_mortar.interfaces.driven import Driven
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.newton_method.failures import StepFailed
from dolfinx_mortar.newton_method.linearisation import Balance, Linearisation
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import QPSolution
from dolfinx_mortar.qp.updates import LIMIT

OVERSHOOT = 0.5
"""Share of the force along a step that may be there in the other direction at its end."""

PROBE = 1e-3
"""Part of a Newton step, and of the diagonal, of differences: any that is small will do."""

Solve = Callable[[Linearisation], QPSolution]


@dataclass(frozen=True)
class Settled:
    """A QP in which the tools carry their loads."""

    lin: Linearisation
    solved: QPSolution
    travel: Floats  # (m,) q
    stiffness: Floats  # (m, m) -d(e.z)/dq, where the next Newton iteration begins
    drives: Drives


@dataclass(frozen=True)
class Drives:
    """The unknown motions of all driven tools at an iterate."""

    tools: list[tuple[Interface, Driven]]
    motions: Floats  # (m, n) e, of the owned unknowns of y
    loads: Floats  # (m,) F
    comm: MPI.Comm

    def move(self, travel: Floats) -> None:
        """Move the tools by q (m,)."""
        first = 0
        for _, tool in self.tools:
            end = first + len(tool.names)
            tool.move(travel[first:end])
            first = end

    def missing(self, reactions: Floats) -> tuple[Floats, Floats]:
        """Return F + e.z (m,) for reactions (n,), and the size of its terms (m,); collective."""
        parts = self.motions * reactions
        sums = np.stack([parts.sum(axis=1), np.abs(parts).sum(axis=1)])
        total, size = self.comm.allreduce(sums, op=MPI.SUM)
        return self.loads + total, np.maximum(size, np.abs(self.loads))

    def noise(self, balance: Balance) -> Floats:
        """Return the round-off in what tools carry (m,), of the forces in the bodies; collective.

        A tool may carry nothing while bodies are strained, as after plastic flow.
        """
        arms = maximum(self.comm, *np.abs(self.motions).max(axis=1, initial=0.0))
        return np.asarray(ROUND_OFF * balance.elements * arms)

    def shifted(self, lin: Linearisation, travel: Floats) -> Linearisation:
        """Return the QP with the tools moved by q (m,)."""
        way, bounds = travel @ self.motions, lin.balance.bounds
        upper, law = lin.qp.upper.copy(), lin.qp.friction
        shifted = bounds.upper + way[bounds.dofs]
        upper.array[bounds.dofs] = np.minimum(shifted, PETSc.INFINITY)
        if law is not None and lin.balance.limits is not None:
            law = replace(law, rest=-lin.balance.limits.slip + law.pick(way))
        return replace(lin, qp=replace(lin.qp, upper=upper, friction=law))

    def reactions(self, lin: Linearisation, solved: QPSolution) -> Floats:
        """Return what the closed nodes carry (n,)."""
        z, dofs = solved.z.array_r, lin.balance.bounds.dofs
        carried, on = np.zeros(len(z)), solved.active > 0
        carried[dofs[on]] = z[dofs[on]]
        if (law := lin.qp.friction) is not None:
            law.put(carried, law.pick(z) * law.acts(on[law.normal])[:, None])
        return carried

    def carried(
        self, lin: Linearisation, solved: QPSolution
    ) -> tuple[Floats, Floats, Floats, bool]:
        """Return what closed nodes carry (n,), what is missing, its size, and if any does."""
        found = self.reactions(lin, solved)
        touches = self.comm.allreduce(bool((self.motions * found).any()), op=MPI.LOR)
        return found, *self.missing(found), bool(touches)

    def stiffness(self, lin: Linearisation, carried: Floats) -> Floats:
        """Return sum_j e_aj^2 K^_jj (m,) over the nodes that carry, or the largest; collective."""
        parts = self.motions**2 * np.abs(lin.diagonal.array_r)
        on = self.comm.allreduce((parts * (carried != 0.0)).sum(axis=1), op=MPI.SUM)
        most = maximum(self.comm, *parts.max(axis=1, initial=0.0))
        return np.where(on > 0.0, on, most)

    def until_touching(self, lin: Linearisation, solved: QPSolution, way: Floats) -> float:
        """Return how far along a motion (m,) the first gap closes, inf if none does; collective."""
        dofs = lin.balance.bounds.dofs
        closing = -(way @ self.motions)[dofs]
        left = np.maximum(lin.qp.upper.array_r[dofs] - solved.x.array_r[dofs], 0.0)
        ends = np.divide(left, closing, out=np.full(len(dofs), np.inf), where=closing > 0.0)
        return float(self.comm.allreduce(ends.min(initial=np.inf), op=MPI.MIN))


@dataclass(frozen=True)
class _Try:
    """A QP with the tools moved, its solution, and what their loads miss."""

    lin: Linearisation
    solved: QPSolution
    travel: Floats  # (m,)
    carried: Floats  # (n,)
    missing: Floats  # (m,)
    size: Floats  # (m,)
    touches: bool

    def far(self, diagonal: Floats) -> float:
        """Return the norm of what is missing."""
        return float(np.linalg.norm(self.missing / np.sqrt(diagonal)))


def find_drives(problem: ContactProblem) -> Drives | None:
    """Return the motions of the tools that forces drive, in the present geometry; None for none.

    Without communication.
    """
    tools: list[tuple[Interface, Driven]] = []
    motions: list[Floats] = []
    loads: list[Floats] = []
    frozen = problem.configuration is None
    for link in problem.system.links:
        tool = link.interface.driven()
        if tool is None:
            continue
        given = tool.loads()
        x = problem.X if frozen else problem.positions().array_r.reshape(-1, problem.d)
        parts = tool.motions(x[link.nodes])
        in_frames = np.einsum("nij,mni->mnj", link.coupling.R, parts) * link.constrained
        e = np.zeros((len(given), problem.n, problem.d))
        e[:, link.nodes] = in_frames
        tools.append((link.interface, tool))
        motions.append(e.reshape(len(given), -1))
        loads.append(given)
    if not tools:
        return None
    return Drives(tools, np.concatenate(motions), np.concatenate(loads), problem.comm)


def settle(
    drives: Drives,
    lin: Linearisation,
    solve: Solve,
    rtol: float,
    stiffness: Floats | None,
) -> Settled:
    """Find the motions with which the tools carry their loads; collective.

    Args:
        drives: the tools at the iterate.
        lin: the QP with the tools where they are.
        solve: solves it, and those with other bounds.
        rtol: largest share of the forces on a tool that may be missing.
        stiffness: (m, m) to begin with; None for the diagonal of K^.

    Raises:
        StepFailed: if nothing resists the load of a tool, or it is not found.
    """
    solved = solve(lin)  # as accurately as those with which it is compared
    here = _Try(lin, solved, np.zeros(len(drives.loads)), *drives.carried(lin, solved))
    diagonal = drives.stiffness(lin, here.carried)
    if not diagonal.all():
        raise StepFailed(_unresisted(drives, diagonal == 0.0))
    B: Floats = np.diag(diagonal) if stiffness is None else stiffness
    noise = drives.noise(lin.balance)
    shrink = 1.0  # of one unknown it takes 3 to 8 QPs
    for _ in range(LIMIT):
        if (np.abs(here.missing) <= rtol * here.size + noise).all():
            return Settled(here.lin, here.solved, here.travel, B, drives)
        if here.touches:
            if shrink == 1.0 and len(diagonal) > 1:  # the nodes that touch change, and B with them
                B = _measured(drives, here, solve, lin, diagonal)
            way = np.asarray(shrink * np.linalg.solve(B, here.missing), dtype=np.float64)
        else:
            way = here.missing / diagonal
            touching = drives.until_touching(here.lin, here.solved, way)
            if not np.isfinite(touching):
                raise StepFailed(_unresisted(drives, here.missing != 0.0))
            way *= touching + 1.0
        q = here.travel + way
        at = drives.shifted(lin, q)
        solved = solve(at)
        there = _Try(at, solved, q, *drives.carried(at, solved))
        if here.touches and there.touches and len(diagonal) == 1:
            slope = (here.missing - there.missing) / way
            B = np.diag(slope) if slope[0] > 0.0 else B
        if here.touches and there.missing @ way < -OVERSHOOT * (here.missing @ way):
            shrink = 0.5 * shrink  # beyond the minimum along the way
            continue
        here, shrink = there, 1.0
    raise StepFailed(
        f"the loads of {', '.join(repr(owner) for owner, _ in drives.tools)} are not met in "
        f"{LIMIT} tries: {np.abs(here.missing).max():.3g} is missing; take smaller steps, or "
        "prescribe the position"
    )


def _measured(
    drives: Drives, here: _Try, solve: Solve, lin: Linearisation, diagonal: Floats
) -> Floats:
    """Return -d(missing)/dq by differences, with a part of the diagonal that makes it regular.

    A plate that touches with one node may turn about it.
    """
    small = PROBE * here.far(diagonal) / np.sqrt(diagonal)
    columns = []
    for a, step in enumerate(small):
        q = here.travel.copy()
        q[a] += np.copysign(step, here.missing[a])
        at = drives.shifted(lin, q)
        _, missing, _, _ = drives.carried(at, solve(at))
        columns.append((here.missing - missing) / (q[a] - here.travel[a]))
    found = np.stack(columns, axis=1)
    return np.asarray((found + found.T) / 2 + PROBE * np.diag(diagonal))


def _unresisted(drives: Drives, which: Floats) -> str:
    """Say which load of which tool has nothing against it."""
    unknowns = [(name, owner) for owner, tool in drives.tools for name in tool.names]
    k = int(np.argmax(which))
    name, owner = unknowns[k]
    return (
        f"nothing resists the load {name!r} = {drives.loads[k]:g} on {owner!r}: it is the "
        "force on the tool, which has to press it on the body; turn it round, or prescribe the "
        "position"
    )


def miss(problem: ContactProblem, balance: Balance, contacts: Contacts) -> float:
    """Return by which share of their forces loads of tools are missed at most; collective."""
    drives = find_drives(problem)
    if drives is None:
        return 0.0
    carried = np.zeros(drives.motions.shape[1])
    carried[balance.bounds.dofs] = contacts.reactions(balance)
    if (limits := balance.limits) is not None:
        carried[limits.tangential[limits.some]] = contacts.tangential_reactions(limits)[limits.some]
    missing, size = drives.missing(carried)
    beyond = np.maximum(np.abs(missing) - drives.noise(balance), 0.0)
    share = np.divide(beyond, size, out=np.zeros_like(size), where=size > 0.0)
    return float(share.max())
