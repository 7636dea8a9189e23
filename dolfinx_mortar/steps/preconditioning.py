# SPDX-License-Identifier: MIT
"""What multigrid works on: the tangent in unknowns in which open contacts let the bodies go."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Ints
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.qp import Preconditioning
from dolfinx_mortar.steps.bodies import Bodies, rigid_motions
from dolfinx_mortar.steps.dirichlet import Dirichlet


def create_preconditioning(
    K: PETSc.Mat, system: InterfaceSystem, supports: Dirichlet, bodies: Bodies, held: Ints
) -> Preconditioning:
    """Return the matrix of a preconditioner and its near-null space; collective.

    The near-null space are the rigid motions of the whole. In the unknowns of the QP they have
    w_n = 0 at all covered slave nodes, which is right only where contact is closed; where it is
    open, the unknowns are changed back (`Transformation.uncouple`).

    Args:
        K: the tangent.
        system: the interfaces, with T up to date.
        supports: the Dirichlet conditions.
        bodies: the connected parts of the mesh.
        held: owned unknowns of y that are held at their bounds.
    """
    V, motions = supports.V, rigid_motions(bodies)
    decoupled = np.union1d(eliminated_dofs(system, supports), held).astype(np.int32)
    if system.transformation is not None:
        B, E, motions = system.transformation.uncouple(K, decoupled, motions)
    else:
        B, E = K.copy(), None
    for motion in motions:
        motion.array[decoupled] = 0.0
    diagonal = B.getDiagonal()
    first = V.dofmap.index_map_bs * V.dofmap.index_map.local_range[0]
    rows = (decoupled + first).astype(PETSc.IntType)
    B.zeroRowsColumns(rows, diag=diagonal.sum() / diagonal.getSize())
    B.setOption(PETSc.Mat.Option.SPD, True)
    return Preconditioning(B, E, motions)


def eliminated_dofs(system: InterfaceSystem, supports: Dirichlet) -> Ints:
    """Return the owned unknowns of y that Dirichlet data and ties leave no freedom."""
    d = supports.V.dofmap.index_map_bs
    node, component = np.nonzero(supports.owned)
    parts = [d * node + system.slots()[node, component]]
    for link in system.links:
        if not link.interface.one_sided:
            k, axis = np.nonzero(link.constrained)
            parts.append(d * link.nodes[k] + axis)
    return np.unique(np.concatenate(parts)).astype(np.int32)
