# SPDX-License-Identifier: MIT
"""The jumps of ties in a step, read at its begin."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.interfaces.jump import extended, nodal_function, values_at
from dolfinx_mortar.interfaces.nodal import check_mesh
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.interfaces.tie import Tie


def read_jumps(system: InterfaceSystem, empty: PETSc.Vec) -> dict[int, PETSc.Vec]:
    """Return the displacements (n,) that ties ask of their slave sides, by number; collective.

    Ties without a jump are left out.

    Args:
        system: the interfaces.
        empty: a vector of the displacement, to make others like it.

    Raises:
        ValueError: on all ranks, if a jump lives on another mesh, has another shape than a vector
            at each slave node, holds NaN or infinity, or is longer than the model.
    """
    V, jumps = system.V, {}
    for k, (interface, sides) in enumerate(zip(system.interfaces, system.sides, strict=True)):
        if not isinstance(interface, Tie):
            continue
        check_jump_of(interface, V)
        if interface.jump is None and not interface.tightening.any():
            continue
        given = nodal_function(interface.jump, V)
        with raised_together(V.mesh.comm):
            values = values_at(given, V, sides.nodes) + interface.tightening
        bad = V.mesh.comm.allreduce(int(np.sum(~np.isfinite(values))), op=MPI.SUM)
        if bad:
            raise ValueError(
                f"jump: {bad} values of {interface} are NaN or infinite; check what it is made of"
            )
        longest = float(maximum(V.mesh.comm, np.abs(values).max(initial=0.0))[0])
        if longest > (size := diagonal(V)):
            raise ValueError(
                f"jump: {interface} has a component of {longest:.4g}, more than the whole model's "
                f"diagonal, {size:.4g}: give the displacement of the slave side relative to the "
                "master side, in the unit of the mesh"
            )
        jumps[k] = empty.duplicate()
        shared = (sides.on_slave & sides.on_master)[: system.n]
        jumps[k].array[:] = extended(values, sides.nodes, shared, system.n).ravel()
    return jumps


def diagonal(V: fem.FunctionSpace) -> float:
    """Return the diagonal of the box around the model; collective."""
    x = V.tabulate_dof_coordinates()
    ends = maximum(V.mesh.comm, *x.max(axis=0, initial=-np.inf), *(-x).max(axis=0, initial=-np.inf))
    return float(np.linalg.norm(ends[:3] + ends[3:]))


def check_jump_of(tie: Tie, V: fem.FunctionSpace) -> None:
    """Raise a ValueError on all ranks unless a jump is on V's mesh; collective."""
    with raised_together(V.mesh.comm):
        check_mesh("jump", tie.jump, V)
