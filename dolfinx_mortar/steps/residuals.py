# SPDX-License-Identifier: MIT
"""When a step is done: residuals of the nonlinear problem, each against what is allowed.

Forces are measured against the largest that act, a penetration by the force that would undo it, an
open contact that carries a force by the work of that force in the gap, and both in facet lengths.
In rigid travel or after unloading nothing acts: then against what the step began with, and K u.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.parallel import maximum, norm, ratio
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.steps.contacts import Contacts, find_sliders
from dolfinx_mortar.steps.linearisation import Balance

EPS = float(np.finfo(float).eps)
# A row of a stiffness matrix sums up, in absolute values, to 2 to 4 times its diagonal entry, so
# that |K| |u| <= 4 |diag(K) u|.
ROW_SUM = 4.0
# Operations behind a gap: a coordinate times a shape function, summed over a few facets
GAP_OPERATIONS = 16.0
# Of the step's first residual, K times the prescribed increment, rtol times this may stay: it is
# what the linear solver was asked for, and in a stress-free step the only scale there is.
FIRST_SHARE = 1e-3


@dataclass(frozen=True)
class Scales:
    """The sizes against which an iterate is measured; those of wild iterates count for nothing."""

    facet_length: float
    begun: float = 0.0  # largest norm of external, support or element forces at the begin
    first: float = 0.0  # norm of the first QP's right-hand side
    work: float = 0.0  # |u|_e^2 at the begin
    extent: float = np.inf  # size of the mesh plus the largest prescribed displacement


@dataclass(frozen=True)
class Residuals:
    """What is left at an iterate; ``excess`` <= 1 means that the step is done."""

    forces: float  # norm of T^T (f - F(u)) - z on unknowns with freedom, over the force scale
    contact: float  # penetration and complementarity, on their scales
    excess: float  # largest residual over what is allowed
    limit: float  # norm of forces that is allowed


def round_off(u: fem.Function, diagonal: PETSc.Vec, extent: float = np.inf) -> float:
    """Return the round-off of K u, EPS times the norm of |K| |u|; collective.

    What is farther away than the ``extent`` of mesh and supports counts as being there: a body that
    a singular tangent has thrown away must not excuse the forces that it leaves.
    """
    near = np.clip(u.x.array[: diagonal.local_size], -extent, extent)
    return ROW_SUM * EPS * norm(u.function_space.mesh.comm, diagonal.array_r * near)


def gap_round_off(u: fem.Function) -> float:
    """Return the round-off of gaps, which are differences of coordinates; collective."""
    return GAP_OPERATIONS * EPS * find_extent(u.function_space.mesh, u.x.array)


def find_extent(mesh: Mesh, displacement: Floats) -> float:
    """Return the largest coordinate of the mesh plus the largest displacement; collective."""
    x = mesh.geometry.x
    sizes = maximum(mesh.comm, np.abs(x).max(initial=0.0), np.abs(displacement).max(initial=0.0))
    return float(sizes.sum())


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
    """Judge an iterate, with the multipliers at hand; collective.

    Args:
        u: the iterate.
        balance: forces and constraints in the geometry that is to be judged.
        contacts: the multipliers of the last QP.
        diagonal: of the last K^, which turns a penetration into the force that undoes it.
        scales: what else is measured against.
        elastic_norm: |u|_e of the iterate.
        rtol: tolerance.
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
    forces, floor = norm(comm, free), round_off(u, diagonal, scales.extent)
    acting = max(scales.begun, largest_force(comm, balance, carried))
    scale = max(acting, FIRST_SHARE * scales.first)
    limit = max(rtol * scale, floor)
    if acting <= floor:  # nothing acts but the round-off of K u, which is a share of |K| |u|
        scale = max(scale, floor / EPS)

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
