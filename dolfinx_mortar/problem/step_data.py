# SPDX-License-Identifier: MIT
"""Data of a step; checks of the jumps and overlaps of ties."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import largest, maximum
from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.interfaces.pretension import Bolt
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.system import InterfaceSystem


@dataclass(frozen=True)
class StepData:
    """Data of a step, read at its start."""

    target: Floats  # (n,) prescribed displacements, 0 where free
    asked: Floats  # (owned nodes, d) prescribed minus initial values
    increment: float  # largest of these and of jumps
    # active set (owned nodes,) and directions of slip (owned nodes, d)
    contacts: tuple[Bools, Floats | None] = (np.zeros(0, dtype=bool), None)
    # with friction, of each interface: limits (owned nodes,), and slip partners, None for present
    limits: Sequence[Floats | None] = ()
    partners: Sequence[Partners | None] = ()
    # bodies flow by the changes: the committed state is linearised
    flows: bool = False
    begun: Floats = field(default_factory=lambda: np.zeros(0))  # (n,) u before the prediction
    travel: Floats | None = None  # (m,) predicted motion of tools, or None


def check_jumps(system: InterfaceSystem) -> None:
    """Raise a ValueError on all ranks for NaN or too long jumps; collective."""
    V, comm = system.V, system.V.mesh.comm
    for interface, sides in zip(system.interfaces, system.sides, strict=True):
        if sides.unilateral or sides.hold or (apart := interface.apart(V, sides.nodes)) is None:
            continue
        bad = comm.allreduce(int(np.sum(~np.isfinite(apart))))
        if bad:
            raise ValueError(
                f"jump: {bad} values of {interface} are NaN or infinite; check its data"
            )
        if (longest := largest(comm, apart)) > (size := diagonal(V)):
            raise ValueError(
                f"jump: {interface} has a component of {longest:.4g}, more than the whole model's "
                f"diagonal, {size:.4g}: give the displacement of the slave side relative to the "
                "master side, in the unit of the mesh"
            )


def check_tightening(system: InterfaceSystem) -> str:
    """Describe a pretension that needs a too large overlap, or ""; collective."""
    size = diagonal(system.V)
    for interface in system.interfaces:
        if isinstance(bolt := interface.driven(), Bolt):
            overlap = float(np.linalg.norm(bolt.overlap))
            if overlap > size:
                return (
                    f"the pretension of {interface} needs an overlap of {overlap:.4g}, more than "
                    f"the model's diagonal, {size:.4g}: the force may be too large for the "
                    "stiffness of the bolt (check units of both)"
                )
    return ""


def diagonal(V: fem.FunctionSpace) -> float:
    """Diagonal of the model's box; collective."""
    x = V.tabulate_dof_coordinates()
    ends = maximum(V.mesh.comm, *x.max(axis=0, initial=-np.inf), *(-x).max(axis=0, initial=-np.inf))
    return float(np.linalg.norm(ends[:3] + ends[3:]))
