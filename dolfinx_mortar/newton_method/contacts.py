# SPDX-License-Identifier: MIT
"""Active set and Lagrange multipliers of an iterate: warm start of the next QP."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.interfaces.constraints import SlipLimits
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.newton_method.linearisation import Balance, Linearisation
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import Friction, QPSolution, Sliders


@dataclass(frozen=True)
class Contacts:
    """Active set and Lagrange multipliers at the owned nodes."""

    active: Bools  # (owned nodes,)
    multipliers: Floats  # (owned nodes,) lambda_j, 0 if inactive
    # with friction: tangential reactions over D_jj, and opposed directions of slip
    tangential: Floats | None = None  # (owned nodes, d)
    # (owned nodes, d), 0 if it sticks or is open; in prescribed directions `SlipLimits.shares`
    sliding: Floats | None = None

    def reactions(self, balance: Balance) -> Floats:
        """Return D_jj lambda_j (k,) on the bounded unknowns of a configuration."""
        return np.asarray(balance.bounds.weight * self.multipliers[balance.nodes])

    def tangential_reactions(self, limits: SlipLimits) -> Floats:
        """Return D_jj tangential_j (m, d - 1) in the frames of a configuration."""
        if self.tangential is None:
            return np.zeros(limits.slip.shape)
        return limits.weight[:, None] * limits.along(self.tangential[limits.nodes])

    def after(self, last: "Contacts", limits: SlipLimits | None) -> "Contacts":
        """Correct multipliers for friction in prescribed directions.

        At an inclined support it opens the contact by c lambda_j, so that lambda_j becomes
        (lambda_j + c last lambda_j) / (1 + c).
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
        """Directions of slip (m, d - 1) in these frames; None without friction."""
        if limits is None or self.sliding is None:
            return None
        along = limits.along(self.sliding[limits.nodes])
        size = np.linalg.norm(along, axis=1, keepdims=True)
        return np.divide(along, size, out=np.zeros_like(along), where=size > 0.0)

    def kappa(self, limits: SlipLimits | None) -> Floats | None:
        """Tangential reactions over slips (m,), inf for zeros; None without friction."""
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

    Slipping nodes start as slipping, lest a sliding body pass through free states, but as sticking
    where the rigid prediction reverses their slip by more than ``noise``.

    Args:
        contacts: active set and slip directions at the end of the last step.
        limits: of the step's first balance; None without friction.
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
    """Slips above ``noise``, tangential reactions, limits mu D_jj lambda_j at friction nodes."""
    size = np.linalg.norm(limits.slip, axis=1, keepdims=True)
    share = np.divide(np.maximum(size - noise, 0.0), size, out=np.zeros_like(size), where=size > 0)
    position = np.arange(len(size), dtype=np.int32)
    law = Friction(position, limits.tangential, -limits.slip, *limits.left)
    stiffness = law.means(diagonal.array_r)
    pressing = limits.weight * contacts.multipliers[limits.nodes]
    reaction = contacts.tangential_reactions(limits)
    return Sliders(law, share * limits.slip, reaction, law.limit(pressing), stiffness)


def contact_forces(problem: ContactProblem, contacts: Contacts) -> Floats:
    """Contact forces (n,) on both sides in the present geometry; collective."""
    total = normal_forces(problem, contacts)
    if contacts.tangential is not None:
        total = total + tangential_forces(problem, contacts)
    return total.ravel()


def normal_forces(problem: ContactProblem, contacts: Contacts) -> Floats:
    """Return B^T lambda (owned nodes, d) of the contacts; collective."""
    return _on_both_sides(
        problem, lambda link: contacts.multipliers[link.nodes, None] * link.coupling.normals
    )


def tangential_forces(problem: ContactProblem, contacts: Contacts) -> Floats:
    """Same of friction; collective."""
    tangential = contacts.tangential
    if tangential is None:
        return np.zeros((problem.n, problem.d))
    return _on_both_sides(problem, lambda link: tangential[link.nodes])


def _on_both_sides(problem: ContactProblem, tractions: Callable[[Link], Floats]) -> Floats:
    """Nodal forces (owned nodes, d) of tractions at slave nodes; collective."""
    total: Floats = np.zeros((problem.n, problem.d))
    for link in problem.system.unilateral:
        slave, master = link.exert(link.coupling.weight[:, :1] * tractions(link))
        total += slave + master
    return total
