# SPDX-License-Identifier: MIT
"""Quadratic programs with bounds and friction: data, backends, linear systems, one check.

For PETSc matrices and vectors; without meshes, forms or contact.
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
