# SPDX-License-Identifier: MIT
"""The updated geometry as a fixed point: its change, and whether it is frozen for now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum, ratio
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.newton_method.linearisation import Balance
from dolfinx_mortar.newton_method.residuals import DIGIT
from dolfinx_mortar.problem.problem import ContactProblem

# A fixed point whose change grows so often, with Newton converged in between, does not contract.
# 1, 2 and 4 give the same in 18 cases of large sliding, rolling and metals, with 0 eight of them
# fail; in 300 random problems there is no rise. A plate that flows (ARCHITECTURE) needs it.
MOST_RISES = 2
# The exact tangent serves from the second iteration on at finite strain, once forces and gaps miss
# their balance by no more than this share at small strain, where the last tangent was indefinite
# and shifted, and where a surface meets itself. Residuals of plastic laws stay at .2 for ten
# iterations in a frozen geometry (sweep pile, seed 4), and an exact tangent that fails there starts
# the fixed point anew, in its cycle. Seed 5055 of the sweep finite, whose cells fold, takes 28
# iterations with it, with .3 50 and a cut. A surface that meets itself: other facets may face each
# other after a long step; with .3 a slider, one tag for both bodies (test_folds), ended a step with
# a flank paired, too, and V 1 % smaller. At finite strain an iteration that leads away is undone:
# 59 cases of large sliding and rings take 2938 iterations, from .3 on and with another rule for
# updates that lead nowhere 2945.
NEAR = 0.03
# It is of use where updates of the geometry, not the laws, cause so much of the residual, and has
# failed where an iteration leaves more of it. Eighteen cases of large sliding, rolling and metals,
# 441 steps: 938, 932, 931, 937 iterations with 1/8, 1/4, 1/2, .9; with 2 three of five metals fail.
SHARE = 0.5
# And where it saves iterations: each costs an unsymmetric factorisation, which with linear laws
# those of the fixed point do not: 47 thousand unknowns, elastic: .6 s against .2 s.
SAVED = {True: 8.0, False: 3.0}
# It has failed where an iteration does not lower the residual to that share of the last one, too,
# and is tried again only a digit below that; from there on, and where the fixed point has failed.


@dataclass(frozen=True)
class Watch:
    """State of the fixed point: whether the geometry is frozen, and its last change."""

    moving: bool
    held: bool = False
    change: float = np.inf  # work of the contact forces in the last change of the gaps
    forces: float = np.inf  # residual of forces after it
    rises: int = 0  # successive changes that grew although Newton had converged between them
    turned: float = 0.0  # by how much it changed the contact forces, over their tolerance
    rate: float = np.inf  # that, over the one before
    exact: bool = False  # whether the exact tangent has served, and goes on
    barred: float = np.inf  # above this excess the exact tangent is not used
    failed: int = 0  # how often it has failed after the fixed point did

    def after(self, change: float, forces: float) -> Watch:
        """Return the state after an update: frozen unless its change or the residual decreases."""
        grows = change >= self.change and forces >= self.forces
        rises = self.rises + 1 if grows and self.held else 0
        return replace(self, held=grows, change=change, forces=forces, rises=rises)

    def turning(self, turned: float) -> Watch:
        """Return the state with the change of the contact forces by the update, and its rate."""
        return replace(self, turned=turned, rate=ratio(turned, self.turned))

    def after_exact(self, excess: float, before: float, *, other_nodes: bool = False) -> Watch:
        """Return the state after an iteration with the exact tangent, by its residuals.

        The fixed point starts anew. Where that had failed, the exact tangent goes on, and where
        other nodes than before carry multipliers: then gaps and forces jump, which is no fault of
        the tangent. With `Coupling.lost` they do not alternate. Sweep finite, seed 2023: a node of
        the rim gets and loses its multiplier, residuals stay at .01 for two iterations; without the
        tangent the fixed point then grows to .8, with it the step ends after 7.

        Args:
            excess: largest residual after it, over its tolerance or scale.
            before: that before it.
            other_nodes: whether other nodes carry multipliers since.
        """
        failed = not excess <= SHARE * before
        fresh = Watch(self.moving, barred=self.barred, failed=self.failed)
        if self.rises >= MOST_RISES:
            return replace(fresh, rises=self.rises, failed=self.failed + failed)
        if failed and not other_nodes:
            return replace(fresh, barred=DIGIT * before)
        return replace(fresh, exact=True)

    def thawed(self) -> Watch:
        """Return the state after an update that Newton's method has not converged before."""
        return replace(self, held=False, change=np.inf, forces=np.inf)

    def is_slow(self, linear: bool, forces: float, excess: float) -> bool:
        """Tell whether the fixed point needs so many more iterations that the exact tangent pays.

        Args:
            linear: whether the laws are linear: then the geometry alone is out of balance.
            forces: residual of forces over its tolerance.
            excess: largest residual over its tolerance.
        """
        if self.held or self.exact:
            return True
        if not linear and not self.turned > SHARE * forces:
            return False
        if not 0.0 < self.rate < np.inf:
            return False
        return self.rate >= 1.0 or np.log(excess) > -SAVED[linear] * np.log(self.rate)


def find_change(
    comm: MPI.Comm, balance: Balance, contacts: Contacts, predicted: Floats
) -> tuple[float, float]:
    """Return how far the gaps of closed contacts are from their prediction.

    The largest, and the work of the contact forces in all of them; collective.
    """
    nodes = balance.nodes
    off = np.abs(balance.bounds.upper - predicted[nodes])
    off[~contacts.active[nodes] | ~np.isfinite(off)] = 0.0
    largest = float(maximum(comm, off.max(initial=0.0))[0])
    work = comm.allreduce(float(np.abs(contacts.reactions(balance)) @ off), op=MPI.SUM)
    return largest, float(work)


def contact_forces(problem: ContactProblem, contacts: Contacts) -> Floats:
    """Return the forces of these contacts on both sides (n,), in the present geometry; collective.

    They are B^T lambda, with friction that of its reactions, too.
    """
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
    """Return the same of friction, zero without; collective."""
    tangential = contacts.tangential
    if tangential is None:
        return np.zeros((problem.n, problem.d))
    return _on_both_sides(problem, lambda link: tangential[link.nodes])


def _on_both_sides(problem: ContactProblem, tractions: Callable[[Link], Floats]) -> Floats:
    """Return the nodal forces (owned nodes, d) of tractions at slave nodes; collective."""
    total: Floats = np.zeros((problem.n, problem.d))
    for link in problem.system.unilateral:
        slave, master = link.exert(link.coupling.weight[:, :1] * tractions(link))
        total += slave + master
    return total
