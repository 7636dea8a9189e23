# SPDX-License-Identifier: MIT
"""Bound-constrained quadratic programs: data, backends, and one check of their solutions.

For min 1/2 x'Ax - b'x over lower <= x <= upper, with friction, and the linear systems inside.
Uses PETSc matrices, vectors and options; imports nothing of meshes, forms or contact.
"""

from dolfinx_mortar.qp.bound_qp import (
    KKT,
    BoundQP,
    Friction,
    QPNotSolved,
    QPSolution,
    Scalars,
    Sliders,
    UnusableQP,
    check,
)
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.options import MULTIGRID, check_options
from dolfinx_mortar.qp.preconditioner import Change, Unknowns
from dolfinx_mortar.qp.scalars import NoResistance, moved
from dolfinx_mortar.qp.solver import available, check_name, solve

__all__ = [
    "KKT",
    "MULTIGRID",
    "BoundQP",
    "Change",
    "Friction",
    "LinearSolveFailed",
    "LinearSolver",
    "NoResistance",
    "QPNotSolved",
    "QPSolution",
    "Scalars",
    "Sliders",
    "Unknowns",
    "UnusableQP",
    "available",
    "check",
    "check_name",
    "check_options",
    "moved",
    "solve",
]
