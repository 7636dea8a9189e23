# SPDX-License-Identifier: MIT
"""Jumps and pretensions of ties: read at the start of a step, set at its end."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.interface import ask
from dolfinx_mortar.interfaces.jump import extended
from dolfinx_mortar.interfaces.pretension import Pretension
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.solid.term import Term


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
        values = ask(V.mesh.comm, interface, "jump_at", V, sides.nodes)
        if values is None:
            continue
        bad = V.mesh.comm.allreduce(int(np.sum(~np.isfinite(values))), op=MPI.SUM)
        if bad:
            raise ValueError(
                f"jump: {bad} values of {interface} are NaN or infinite; check its data"
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


class TooFar(Exception):
    """A pretension needs an overlap longer than the model."""


class Pretensions(Term):
    """The work -sum_k F_k s_k of the pretensions of ties on their overlaps, see `Pretension`.

    Attributes:
        forces: F_k of the step, by the number of the tie.
    """

    linear = True
    has_tangent = False

    def __init__(self, u: fem.Function, system: InterfaceSystem) -> None:
        """Start without a force."""
        self.forces: dict[int, float] = {}
        self._u, self._system = u, system

    def begin(self, start: float, end: float) -> None:
        """Read the forces.

        Raises:
            ValueError: on all ranks, if the value of a Constant is NaN or infinite.
        """
        self.forces = {}
        for k, interface in enumerate(self._system.interfaces):
            force = ask(self._system.V.mesh.comm, interface, "given_force")
            if force is not None:
                self.forces[k] = force

    def given(self) -> tuple[tuple[Pretension, float], ...]:
        """Return the unknowns in T with their forces."""
        found = self._system.pretensions
        return tuple((one, self.forces[one.number]) for one in found if one.number in self.forces)

    def energy(self) -> Floats:
        """Return the addends of this rank."""
        pairs = [-F * one.pair.array_r * self._owned(one) for one, F in self.given()]
        return np.concatenate([np.zeros(0), *pairs])

    def _owned(self, one: Pretension) -> Floats:
        return np.asarray(self._u.x.array[: one.pair.local_size])

    def add_forces(self, F: PETSc.Vec) -> None:
        """Subtract the pairs of nodal forces."""
        for one, force in self.given():
            F.array_w[:] -= force * one.pair.array_r

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add nothing: the overlaps are linear in u."""


def tighten(
    system: InterfaceSystem, u: PETSc.Vec, jumps: dict[int, PETSc.Vec]
) -> dict[int, PETSc.Vec]:
    """Add the overlaps of a step to the tightening of its ties; return the new jumps; collective.

    Args:
        system: the interfaces, with the T of the step.
        u: (n,) displacement at the end of the step.
        jumps: as `read_jumps` has returned them at its start.

    Raises:
        TooFar: on all ranks, for an overlap longer than the model's diagonal; nothing is added.
    """
    overlaps = [system.overlap(pretension, u, jumps) for pretension in system.pretensions]
    size = diagonal(system.V) if overlaps else 0.0
    for pretension, overlap in zip(system.pretensions, overlaps, strict=True):
        if abs(overlap) > size:
            raise TooFar(
                f"the pretension of {system.interfaces[pretension.number]} needs an overlap of "
                f"{abs(overlap):.4g}, more than the model's diagonal, {size:.4g}: the force may be "
                "too large for the stiffness of the bolt (check units of both)"
            )
    found = dict(jumps)
    for pretension, overlap in zip(system.pretensions, overlaps, strict=True):
        k = pretension.number
        way = overlap * pretension.axis
        ask(system.V.mesh.comm, system.interfaces[k], "tighten", way)
        found[k] = jumps[k].copy() if k in jumps else 0.0 * u
        found[k].array.reshape(-1, len(way))[system.sides[k].nodes] += way
    return found


def diagonal(V: fem.FunctionSpace) -> float:
    """Return the diagonal of the box around the model; collective."""
    x = V.tabulate_dof_coordinates()
    ends = maximum(V.mesh.comm, *x.max(axis=0, initial=-np.inf), *(-x).max(axis=0, initial=-np.inf))
    return float(np.linalg.norm(ends[:3] + ends[3:]))
