# SPDX-License-Identifier: MIT
"""Active set and multipliers of an iterate, warm start of the next QP, and its KKT residuals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, largest, norm, ratio
from dolfinx_mortar.common.arrays import ROUND_OFF, Bools, Floats
from dolfinx_mortar.interfaces.constraints import SlipLimits
from dolfinx_mortar.problem.linearisation import Balance, Linearisation, find_extent, wear_rates
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import Friction, QPSolution, Sliders


@dataclass(frozen=True)
class Contacts:
    """Active set and Lagrange multipliers at the owned nodes."""

    active: Bools  # (owned nodes,)
    multipliers: Floats  # (owned nodes,) lambda_j, 0 if inactive
    # with friction: tangential reactions over D_jj
    tangential: Floats | None = None  # (owned nodes, d)
    # (owned nodes, d) directions of slip or 0; `SlipLimits.shares` in prescribed directions
    sliding: Floats | None = None

    def reactions(self, balance: Balance) -> Floats:
        """Reactions D_jj lambda_j (k,) on the bounded unknowns."""
        return balance.bounds.weight * self.multipliers[balance.nodes]

    def tangential_reactions(self, limits: SlipLimits) -> Floats:
        """Reactions D_jj tangential_j (m, d - 1) in the frames."""
        if self.tangential is None:
            return np.zeros(limits.slip.shape)
        return limits.weight[:, None] * limits.along(self.tangential[limits.nodes])

    def after(self, last: "Contacts", limits: SlipLimits | None) -> "Contacts":
        """Correct multipliers for friction in prescribed directions.

        At an inclined support it opens the contact by c lambda_j: lambda_j becomes (lambda_j + c
        last lambda_j) / (1 + c).
        """
        if limits is None:
            return self
        multipliers, nodes = self.multipliers.copy(), limits.nodes
        change = multipliers[nodes] - last.multipliers[nodes]
        change = change / np.maximum(1.0 + limits.wedging, 0.5)
        multipliers[nodes] = np.where(
            self.active[nodes], last.multipliers[nodes] + change, multipliers[nodes]
        )
        return replace(self, multipliers=multipliers)

    def completed(self, limits: SlipLimits | None) -> "Contacts":
        """Add the tractions in prescribed directions."""
        if limits is None or self.tangential is None:
            return self
        assert self.sliding is not None
        tangential, sliding, nodes = self.tangential.copy(), self.sliding.copy(), limits.nodes
        known = limits.known(self.multipliers) / limits.weight[:, None]
        tangential[nodes] = limits.vectors(limits.along(tangential[nodes])) + known
        shares = np.where(known != 0.0, limits.shares, 0.0)
        sliding[nodes] = limits.vectors(limits.along(sliding[nodes])) + shares
        return replace(self, tangential=tangential, sliding=sliding)

    def directions(self, limits: SlipLimits | None) -> Floats | None:
        """Directions of slip (m, d - 1) in these frames."""
        if limits is None or self.sliding is None:
            return None
        along = limits.along(self.sliding[limits.nodes])
        size = np.linalg.norm(along, axis=1, keepdims=True)
        return np.divide(along, size, out=np.zeros_like(along), where=size > 0.0)

    def kappa(self, limits: SlipLimits | None) -> Floats | None:
        """Tangential reactions over slips (m,), inf for zeros."""
        if limits is None:
            return None
        force = np.linalg.norm(self.tangential_reactions(limits), axis=1)
        slip = np.linalg.norm(limits.slip, axis=1)
        some = (force > 0.0) & (slip > 0.0)
        return np.divide(force, slip, out=np.full_like(slip, np.inf), where=some)


def go_on(
    contacts: tuple[Bools, Floats | None], limits: SlipLimits | None, noise: float
) -> Contacts:
    """Initial active set of a step: that of the last one, without multipliers.

    Slipping nodes start as slipping, but as sticking where the rigid prediction reverses their slip
    by more than ``noise``. `contacts` are the last active set and slip directions.
    """
    active, sliding = contacts
    if limits is not None and sliding is not None:
        nodes = limits.nodes
        back = (limits.along(sliding[nodes]) * limits.slip).sum(axis=1) < -noise
        sliding = sliding.copy()
        sliding[nodes[back]] = 0.0
    return Contacts(active, np.zeros(len(active)), sliding=sliding)


def found_by(lin: Linearisation, solved: QPSolution, n: int) -> Contacts:
    """Active set and multipliers of a QP's solution, at n owned nodes."""
    bounds, nodes, on = lin.balance.bounds, lin.balance.nodes, solved.active > 0
    active, multipliers = np.zeros(n, dtype=bool), np.zeros(n)
    active[nodes] = on
    multipliers[nodes[on]] = solved.z.array_r[bounds.dofs[on]] / bounds.weight[on]
    law, limits = lin.qp.friction, lin.balance.limits
    if law is None or limits is None or solved.sliding is None:
        return Contacts(active, multipliers)
    tangential, sliding = np.zeros((2, n, limits.axes.shape[2]))
    carried = law.pick(solved.z.array_r) * law.acts(active[limits.nodes])[:, None]
    tangential[limits.nodes] = limits.vectors(carried) / limits.weight[:, None]
    sliding[limits.nodes] = limits.vectors(solved.sliding)
    return Contacts(active, multipliers, tangential, sliding)


def find_sliders(
    limits: SlipLimits, contacts: Contacts, diagonal: PETSc.Vec, noise: float
) -> Sliders:
    """Slips above ``noise``, reactions and limits at friction nodes."""
    size = np.linalg.norm(limits.slip, axis=1, keepdims=True)
    share = np.divide(np.maximum(size - noise, 0.0), size, out=np.zeros_like(size), where=size > 0)
    position = np.arange(len(size), dtype=np.int32)
    law = Friction(position, limits.tangential, -limits.slip, *limits.left)
    stiffness = law.means(diagonal.array_r)
    pressing = limits.weight * contacts.multipliers[limits.nodes]
    reaction = contacts.tangential_reactions(limits)
    return Sliders(law, share * limits.slip, reaction, law.limit(pressing), stiffness)


def wear_off(
    problem: ContactProblem, balance: Balance, contacts: Contacts, stiffness: PETSc.Vec
) -> str:
    """Set the depths of wear after a step, or say why it is too long; collective."""
    if balance.give is None:
        return ""
    told, per_area = list[str](), np.zeros(problem.n)
    bounds = balance.bounds
    per_area[balance.nodes] = stiffness.array_r[bounds.dofs] / bounds.weight
    rates = {of: wear_rates(problem, balance.limits, implicit=of) for of in (False, True)}
    for link in problem.system.links:
        if (wear := link.interface.wear) is None:
            continue
        rate, on = rates[wear.implicit][link.nodes], contacts.active[link.nodes]
        depth = np.where(on, rate * contacts.multipliers[link.nodes], 0.0)
        ratio = 0.0 if wear.implicit else rate * per_area[link.nodes] * on
        deepest, unstable = largest(problem.comm, depth), largest(problem.comm, ratio + 0.0 * rate)
        if wear.most is not None and deepest > wear.most:
            told.append(f"{link.interface} wears by {deepest:.3g}, more than most={wear.most:g}")
        if unstable > 2.0:
            told.append(
                f"{link.interface}: explicit wear would oscillate, as k ds K_jj / D_jj is "
                f"{unstable:.3g}, above 2; give implicit=True, or"
            )
        cast(Any, link.interface).wear_by(depth, link.nodes)
    if told:
        return f"{'; '.join(told)}: take shorter paths in a step"
    if any_rank(problem.comm, (rates[True] > 0.0).any())[0]:
        problem.follow_geometry()
    return ""


def contact_forces(problem: ContactProblem, contacts: Contacts) -> Floats:
    """Normal and tangential forces (2, owned nodes, d) on both sides; collective."""
    total: Floats = np.zeros((2, problem.n, problem.d))
    for link in problem.system.unilateral:
        tractions = [contacts.multipliers[link.nodes, None] * link.coupling.normals]
        if contacts.tangential is not None:
            tractions.append(contacts.tangential[link.nodes])
        for k, traction in enumerate(tractions):
            slave, master = link.exert(link.coupling.weight[:, :1] * traction)
            total[k] += slave + master
    return total


# Error of a QP relative to the residual expected next (Eisenstat and Walker 1996).
FORCING = {"direct": 1e-3, "iterative": 1e-1}
# Share of the step's tolerance for a QP; the first one, and those after no progress, get a digit
# more, as small missing forces are large plastic motions.
DIGIT = 0.1


@dataclass(frozen=True)
class Scales:
    """Scales of the residuals; diverging iterates do not enlarge them.

    Without forces the first residual and the round-off of K u, at finite strain of K h.
    """

    facet_length: float
    begun: float = 0.0  # largest force norm at the start
    first: float = 0.0  # norm of the first QP's right-hand side
    work: float = 0.0  # |u|_e^2 at the start
    extent: float = np.inf  # mesh size plus largest prescribed displacement
    cells: Floats | float = 0.0  # cell size around each owned dof, 0 at small strain


@dataclass(frozen=True)
class Residuals:
    """Residuals at an iterate; ``excess`` <= 1 means convergence."""

    forces: float  # |T^T (f - F(u)) - z| on free unknowns, relative
    contact: float  # penetration and complementarity, relative
    excess: float  # largest residual over its tolerance
    limit: float  # tolerance of the force norm
    loads: float = 0.0  # largest relative residual of a driving load


def round_off(
    u: fem.Function,
    diagonal: PETSc.Vec,
    extent: float = np.inf,
    cells: Floats | float = 0.0,
) -> float:
    """Round-off of K u, ROUND_OFF |diag(K) (|u| + h)|, h = ``cells``; collective.

    u is clipped at ``extent``: a singular tangent would loosen the force tolerance.
    """
    near = np.abs(u.x.array[: diagonal.local_size]).clip(max=extent) + cells
    return ROUND_OFF * norm(u.function_space.mesh.comm, diagonal.array_r * near)


def gap_round_off(u: fem.Function) -> float:
    """Round-off of gaps, which are differences of coordinates; collective."""
    return ROUND_OFF * find_extent(u.function_space.mesh, u.x.array)


def largest_force(comm: MPI.Comm, balance: Balance, z: Floats) -> float:
    """Largest norm of external, contact, support and element forces; collective."""
    supports = balance.reduced.array_r[balance.equal.dofs]
    return max(balance.external, balance.elements, norm(comm, z), norm(comm, supports))


def measure(
    u: fem.Function,
    balance: Balance,
    contacts: Contacts,
    diagonal: PETSc.Vec,
    scales: Scales,
    elastic_norm: float,
    rtol: float,
) -> Residuals:
    """KKT residuals of an iterate with given multipliers; collective.

    `diagonal` of the last K^ scales penetrations to forces; `elastic_norm` is |u|_e.
    """
    comm, z = u.function_space.mesh.comm, contacts.reactions(balance)
    free = balance.reduced.array_r.copy()
    free[balance.bounds.dofs] -= z
    noise = gap_round_off(u)
    missing, carried = np.zeros(0), z
    if (limits := balance.limits) is not None:
        sliders = find_sliders(limits, contacts, diagonal, noise)
        free[limits.tangential[limits.some]] -= sliders.reaction[limits.some]
        missing = sliders.error().ravel()
        carried = np.concatenate([z, sliders.reaction.ravel()])
    free[balance.equal.dofs] = 0.0
    forces, floor = norm(comm, free), round_off(u, diagonal, scales.extent, scales.cells)
    now = largest_force(comm, balance, carried)
    acting = max(scales.begun, now)
    scale, limit = acting, max(rtol * acting, floor)
    if acting <= (left := tightest(rtol) * scales.first):
        scale, limit = left / rtol, max(limit, left)
    if acting <= floor:
        scale = max(scale, floor / ROUND_OFF)
    of_gaps = norm(comm, noise * diagonal.array_r[balance.bounds.dofs])
    if now <= of_gaps:
        limit = max(limit, of_gaps)

    active, gap = contacts.active[balance.nodes], balance.bounds.upper
    room: Floats | float = noise
    if (give := balance.give) is not None:
        gap, room = gap + give * z, noise + give * floor
    off = np.maximum(np.where(active, np.abs(gap), np.maximum(-gap, 0.0)) - room, 0.0)
    missed = np.maximum(np.abs(balance.equal.upper) - noise, 0.0)
    stiffness = diagonal.array_r
    pull = norm(
        comm,
        np.where(active, 0.0, stiffness[balance.bounds.dofs] * off),
        stiffness[balance.equal.dofs] * missed,
        missing,
    )
    work = comm.allreduce(float(np.abs(z) @ off))
    whole = max(scales.work, elastic_norm**2, limit * scales.facet_length)
    widest = largest(comm, off) / scales.facet_length
    excess = max(ratio(forces, limit), ratio(pull, limit), ratio(work, rtol * whole), widest / rtol)
    contact = max(ratio(pull, scale), ratio(work, whole))
    return Residuals(ratio(forces, scale), contact, excess, limit)


def tightest(rtol: float) -> float:
    """Relative tolerance of the only QP of a linear step.

    >>> tightest(1e-6)
    1e-09
    """
    return max(ROUND_OFF, FORCING["direct"] * rtol)


def next_tolerance(kind: str, rtol: float, size: float, residuals: Sequence[Residuals]) -> float:
    """Relative tolerance of the next QP of a nonlinear step, "direct" or "iterative".

    `size` is the norm of the QP's right-hand side, `residuals` are those of the iterates so far.

    >>> round(next_tolerance("iterative", 1e-6, 1.0, []), 12)
    0.01
    """
    first = DIGIT * FORCING[kind]
    if not residuals:
        return max(tightest(rtol), first)
    last = residuals[-1]
    before = residuals[-2].excess if len(residuals) > 1 else np.inf
    contraction = min(1.0, last.excess / before) if 0.0 < before < np.inf else 1.0
    least = int(np.argmin([residual.excess for residual in residuals]))
    stalled = len(residuals) - 1 - least
    share = FORCING[kind] * DIGIT**stalled * contraction
    allowed = max(DIGIT, share * last.excess) * last.limit
    return float(max(tightest(rtol), min(first, allowed / size if size > 0.0 else 1.0)))
