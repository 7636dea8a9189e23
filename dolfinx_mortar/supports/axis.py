# SPDX-License-Identifier: MIT
"""Checks of the axis of rotation: free nodes and facets on it."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import ROUND_OFF, Floats
from dolfinx_mortar.interfaces.coupling import Sides
from dolfinx_mortar.solid.kinematics import on_axis
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.supports.dirichlet import Dirichlet


def check_axis(solid: Solid, supports: Dirichlet, sides: Sequence[Sides]) -> None:
    """Raise a ValueError on all ranks for free nodes or facets on the axis; collective.

    A radial displacement there makes u_r / r infinite, or merely large on a mesh.
    """
    V, i = solid.V, solid.kinematics.radius
    if i is None:
        return
    axis = on_axis(solid.kinematics, V.mesh, V.tabulate_dof_coordinates())
    free = axis[: len(supports.owned)] & ~supports.owned[:, i]
    missing = V.mesh.comm.allreduce(int(np.sum(free)), op=MPI.SUM)
    if missing:
        raise ValueError(
            f"bcs: {missing} nodes on the axis r = 0 are not held in r, where u_r / r has no limit "
            f"otherwise; prescribe 0 on V.sub({i}) at the nodes with x[{i}] = 0"
        )
    for side in sides:
        for surface, name in zip(side.surfaces, ("slave", "master"), strict=False):
            flat = axis[surface.nodes[surface.facets]].all(axis=1)
            bad = V.mesh.comm.allreduce(int(np.sum(flat)), op=MPI.SUM)
            if bad:
                raise ValueError(
                    f"{name}={surface.label}: {bad} facets lie on the axis r = 0, which is inside "
                    "the body; leave them out of the tag"
                )


def check_targets(solid: Solid, target: Floats) -> None:
    """Raise a ValueError on all ranks for values (dofs,) that leave the axis; collective."""
    V, i = solid.V, solid.kinematics.radius
    if i is None:
        return
    radial = target.reshape(-1, V.dofmap.index_map_bs)[:, i]
    axis = on_axis(solid.kinematics, V.mesh, V.tabulate_dof_coordinates()[: len(radial)])
    largest = float(maximum(V.mesh.comm, np.abs(target).max(initial=0.0))[0])
    leaving = axis & (np.abs(radial) > ROUND_OFF * largest)  # round-off of interpolation
    moved = V.mesh.comm.allreduce(int(np.sum(leaving)), op=MPI.SUM)
    if moved:
        raise ValueError(
            f"bcs: {moved} nodes on the axis r = 0 are prescribed to leave it, which opens a hole "
            f"in the body; prescribe 0 on V.sub({i}) there"
        )
