# SPDX-License-Identifier: MIT
"""Convergence: KKT residuals of the nonlinear problem over their tolerances, accuracy of QPs.

Forces are relative to the largest force of the step, a penetration counts as the force that would
undo it, a complementarity defect as the work of the multiplier in the gap, and both are at most
rtol facet lengths. In rigid motion, before loading and after unloading there is no force: then the
first residual of the step and the round-off of K u are the scales. At finite strain F = I + grad u
is rounded, too, whatever u: as if u were the size h of the cells around each node. Measured at
u = 0, with K/mu from 2 to 1e5: residuals of .1 to .7 EPS |diag(K) h|, where ROUND_OFF is 16 EPS.
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

# The error allowed to a QP, as a share of the residual that the contraction seen so far promises
# for the next iterate (Eisenstat and Walker 1996). Digits are cheap with a factorisation only.
FORCING = {"direct": 1e-3, "iterative": 1e-1}
# One digit: a QP may leave this share of what the step allows; the first QP of a nonlinear step,
# before any contraction is known, and each one after an iteration that has not lowered the
# residual, are so much more accurate. The error may be the cause: where a body flows, small forces
# that a QP misses are large motions.
DIGIT = 0.1


@dataclass(frozen=True)
class Scales:
    """Scales of the residuals; iterates outside the extent of the model do not enlarge them."""

    facet_length: float
    begun: float = 0.0  # largest norm of external, support or element forces at its start
    first: float = 0.0  # norm of the first QP's right-hand side
    work: float = 0.0  # |u|_e^2 at the start of the step
    extent: float = np.inf  # size of the mesh plus the largest prescribed displacement
    cells: Floats | float = 0.0  # size of the cells around each owned dof, 0 at small strain


@dataclass(frozen=True)
class Residuals:
    """Residuals at an iterate; ``excess`` <= 1 means convergence."""

    forces: float  # norm of T^T (f - F(u)) - z on unknowns with freedom, over the force scale
    contact: float  # penetration and complementarity, on their scales
    excess: float  # largest residual over its tolerance
    limit: float  # tolerance of the norm of forces
    loads: float = 0.0  # largest share of the load of a bolt, tool or rigid side that is missed


def round_off(
    u: fem.Function,
    diagonal: PETSc.Vec,
    extent: float = np.inf,
    cells: Floats | float = 0.0,
) -> float:
    """Return the round-off of K u, ROUND_OFF times the norm of diag(K) (|u| + h); collective.

    Displacements count up to the ``extent`` of mesh and supports: where a singular tangent gives
    larger ones, they must not loosen the force tolerance. h: see `Scales.cells`.
    """
    near = np.abs(u.x.array[: diagonal.local_size]).clip(max=extent) + cells
    return ROUND_OFF * norm(u.function_space.mesh.comm, diagonal.array_r * near)


def gap_round_off(u: fem.Function) -> float:
    """Return the round-off of gaps, which are differences of coordinates; collective."""
    return ROUND_OFF * find_extent(u.function_space.mesh, u.x.array)


def largest_force(comm: MPI.Comm, balance: Balance, z: Floats) -> float:
    """Return the largest norm of external, contact, support and element forces; collective."""
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
    """Return the KKT residuals of an iterate with given multipliers; collective.

    Args:
        u: the iterate.
        balance: forces and constraints in the geometry that is to be judged.
        contacts: the multipliers of the last QP.
        diagonal: of the last K^, the stiffness by which a penetration is compared with a force.
        scales: further scales of the step.
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
    # the residual that a QP may leave at the start is the only scale of a stress-free step
    if acting <= (left := tightest(rtol) * scales.first):
        scale, limit = left / rtol, max(limit, left)
    if acting <= floor:  # nothing acts but the round-off of K u
        scale = max(scale, floor / ROUND_OFF)
    of_gaps = norm(comm, noise * diagonal.array_r[balance.bounds.dofs])
    if now <= of_gaps:  # nothing acts but the forces of such gaps, whatever did at the start
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
    """Return the relative tolerance of the only QP of a linear step of tolerance rtol.

    >>> tightest(1e-6)
    1e-09
    """
    return max(ROUND_OFF, FORCING["direct"] * rtol)


def next_tolerance(kind: str, rtol: float, size: float, residuals: Sequence[Residuals]) -> float:
    """Return the relative tolerance of the next QP of a nonlinear step.

    The error allowed is a share of the residual that the last contraction promises for the next
    iterate, in a tail that gains one digit an iteration one digit and a bit.

    Args:
        kind: "direct" or "iterative".
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
