# SPDX-License-Identifier: MIT
"""What multigrid works on: the tangent in unknowns in which open contacts let the bodies go."""

from __future__ import annotations

from typing import TYPE_CHECKING

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.qp import Preconditioning
from dolfinx_mortar.steps.bodies import rigid_motions

if TYPE_CHECKING:
    from dolfinx_mortar.steps.problem import ContactProblem


def create_preconditioning(problem: ContactProblem, held: Ints) -> Preconditioning:
    """Return the matrix of a preconditioner and its near-null space; collective.

    The near-null space are the rigid motions of the whole. In the unknowns of the QP they have
    w_n = 0 at all covered slave nodes, which is right only where contact is closed; where it is
    open, the unknowns are changed back (`Transformation.release`).

    Args:
        problem: the problem, with its tangent K and its transformation up to date.
        held: owned unknowns of y that are held at their bounds.
    """
    K, E, motions = problem.K, None, rigid_motions(problem.V)
    if problem.transformation is not None:
        B, E, motions = problem.transformation.release(K, held, motions)
    else:
        B = K.copy()
    decoupled = np.union1d(problem.eliminated, held).astype(np.int32)
    for motion in motions:
        motion.array[decoupled] = 0.0
    diagonal = B.getDiagonal()
    rows = (decoupled + problem.first_dof).astype(PETSc.IntType)
    B.zeroRowsColumns(rows, diag=diagonal.sum() / diagonal.getSize())
    B.setOption(PETSc.Mat.Option.SPD, True)
    return Preconditioning(B, E, motions)
