# SPDX-License-Identifier: MIT
"""Jumps of ties, read at the start of a step."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.jump import extended
from dolfinx_mortar.interfaces.system import InterfaceSystem


def read_jumps(system: InterfaceSystem, empty: PETSc.Vec) -> dict[int, PETSc.Vec]:
    """Return the jumps of ties as displacements (n,) of their slave sides by number; collective.

    Args:
        empty: a vector of the displacement, which is duplicated.

    Raises:
        ValueError: on all ranks, if a jump is on another mesh, has another shape than a vector
            at each slave node, has NaN or infinite values, or is longer than the model.
    """
    V, jumps = system.V, {}
    for k, (interface, sides) in enumerate(zip(system.interfaces, system.sides, strict=True)):
        values = interface.jump_at(V, sides.nodes)
        _check(V, interface, interface.apart_at(V, sides.nodes))
        if values is None:
            continue
        jumps[k] = empty.duplicate()
        shared = (sides.on_slave & sides.on_master)[: system.n]
        jumps[k].array[:] = extended(values, sides.nodes, shared, system.n).ravel()
    return jumps


def _check(V: fem.FunctionSpace, interface: Interface, apart: Floats | None) -> None:
    """Raise a ValueError if sides are farther apart than the model is long, or NaN; collective."""
    if apart is None:
        return
    bad = V.mesh.comm.allreduce(int(np.sum(~np.isfinite(apart))), op=MPI.SUM)
    if bad:
        raise ValueError(f"jump: {bad} values of {interface} are NaN or infinite; check its data")
    longest = float(maximum(V.mesh.comm, np.abs(apart).max(initial=0.0))[0])
    if longest > (size := diagonal(V)):
        raise ValueError(
            f"jump: {interface} has a component of {longest:.4g}, more than the whole model's "
            f"diagonal, {size:.4g}: give the displacement of the slave side relative to the "
            "master side, in the unit of the mesh"
        )


def check_tightening(system: InterfaceSystem) -> str:
    """Say which pretension needs an overlap longer than the model's diagonal, or ""; collective."""
    size = diagonal(system.V)
    for interface in system.interfaces:
        if interface.tightening is not None and interface.driven() is not None:
            overlap = float(np.linalg.norm(interface.tightening))
            if overlap > size:
                return (
                    f"the pretension of {interface} needs an overlap of {overlap:.4g}, more than "
                    f"the model's diagonal, {size:.4g}: the force may be too large for the "
                    "stiffness of the bolt (check units of both)"
                )
    return ""


def diagonal(V: fem.FunctionSpace) -> float:
    """Return the diagonal of the box around the model; collective."""
    x = V.tabulate_dof_coordinates()
    ends = maximum(V.mesh.comm, *x.max(axis=0, initial=-np.inf), *(-x).max(axis=0, initial=-np.inf))
    return float(np.linalg.norm(ends[:3] + ends[3:]))
