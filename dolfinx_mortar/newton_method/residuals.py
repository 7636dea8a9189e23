# SPDX-License-Identifier: MIT
"""Convergence: KKT residuals relative to their tolerances, accuracy of QPs.

Forces are relative to the largest force of the step; a penetration counts as the force that would
remove it, complementarity as work; both are at most rtol facet lengths. Without forces the first
residual and the round-off of K u are the scales, at finite strain of K h, h the cell size:
residuals at u = 0 are .1 to .7 EPS |diag(K) h| for K/mu from 2 to 1e5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum, norm, ratio
from dolfinx_mortar.arrays import ROUND_OFF, Floats
from dolfinx_mortar.newton_method.contacts import Contacts, find_sliders
from dolfinx_mortar.newton_method.linearisation import Balance, find_extent

# Error of a QP relative to the residual expected next (Eisenstat and Walker 1996); digits are cheap
# with a factorisation only.
FORCING = {"direct": 1e-3, "iterative": 1e-1}
# Share of the step's tolerance left to a QP. The first QP of a nonlinear step, and each after an
# iteration without progress, are one digit more accurate: small missing forces are large plastic
# motions.
DIGIT = 0.1


@dataclass(frozen=True)
class Scales:
    """Scales of the residuals; diverging iterates do not enlarge them."""

    facet_length: float
    begun: float = 0.0  # largest norm of external, support or element forces at the start
    first: float = 0.0  # norm of the first QP's right-hand side
    work: float = 0.0  # |u|_e^2 at the start
    extent: float = np.inf  # mesh size plus largest prescribed displacement
    cells: Floats | float = 0.0  # cell size around each owned dof, 0 at small strain


@dataclass(frozen=True)
class Residuals:
    """Residuals at an iterate; ``excess`` <= 1 means convergence."""

    forces: float  # norm of T^T (f - F(u)) - z on free unknowns, relative
    contact: float  # penetration and complementarity, relative
    excess: float  # largest residual over its tolerance
    limit: float  # tolerance of the force norm
    loads: float = 0.0  # largest relative defect of a driving load


def round_off(
    u: fem.Function,
    diagonal: PETSc.Vec,
    extent: float = np.inf,
    cells: Floats | float = 0.0,
) -> float:
    """Round-off of K u, ROUND_OFF |diag(K) (|u| + h)|, h = ``cells``; collective.

    u is clipped at ``extent``, lest a singular tangent loosen the force tolerance.
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

    Args:
        contacts: multipliers of the last QP.
        diagonal: of the last K^, for penetrations as forces.
        elastic_norm: |u|_e of the iterate.
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
    off = np.maximum(np.where(active, np.abs(gap), np.maximum(-gap, 0.0)) - noise, 0.0)
    missed = np.maximum(np.abs(balance.equal.upper) - noise, 0.0)
    stiffness = diagonal.array_r
    pull = norm(
        comm,
        np.where(active, 0.0, stiffness[balance.bounds.dofs] * off),
        stiffness[balance.equal.dofs] * missed,
        missing,
    )
    work = comm.allreduce(float(np.abs(z) @ off), op=MPI.SUM)
    whole = max(scales.work, elastic_norm**2, limit * scales.facet_length)
    widest = float(maximum(comm, off.max(initial=0.0))[0]) / scales.facet_length
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

    Args:
        size: norm of the QP's right-hand side.
        residuals: of the iterates so far.

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
