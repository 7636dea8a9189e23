# SPDX-License-Identifier: MIT
"""Checks of the arguments of a problem and of its steps, the same on all ranks; data of a step."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem
from dolfinx_mortar import qp as backends
from dolfinx_mortar.algebra.parallel import any_rank, largest, maximum, raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import (
    NUMBER,
    check,
    check_optional,
    instance,
    integer,
    number,
    one_of,
)
from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.interfaces.tie import Bolt
from dolfinx_mortar.solid.solid import Solid


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
    """Raise a ValueError on all ranks for NaN, or too long jumps or offsets; collective."""
    V, comm = system.V, system.V.mesh.comm
    for interface, sides in zip(system.interfaces, system.sides, strict=True):
        if sides.hold or (apart := interface.apart(V, sides.nodes)) is None:
            continue
        name, what = "jump", "the displacement of the slave side relative to the master side"
        if sides.unilateral:
            name, what = "offset", "the length that is added to the gap"
        bad = comm.allreduce(int(np.sum(~np.isfinite(apart))))
        if bad:
            raise ValueError(
                f"{name}: {bad} values of {interface} are NaN or infinite; check its data"
            )
        if (longest := largest(comm, apart)) > (size := diagonal(V)):
            raise ValueError(
                f"{name}: {interface} has a component of {longest:.4g}, more than the whole "
                f"model's diagonal, {size:.4g}: give {what}, in the unit of the mesh"
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


GEOMETRIES = ("updated", "reference")
CUTS = ("halve", "none")


def check_arguments(
    solid: Solid,
    interfaces: Iterable[Interface],
    bcs: Iterable[fem.DirichletBC],
    loads: ufl.Form | None,
    potential: ufl.Form | None,
    geometry: str,
    **options: Any,
) -> tuple[list[Interface], list[fem.DirichletBC]]:
    """Check the arguments; return interfaces and conditions as lists; collective."""
    check("solid", solid, instance(Solid, "give a Solid(u, materials, cell_tags)"))
    given, conditions = _unrolled(interfaces), _unrolled(bcs)
    check_same_on_all_ranks(
        solid.V.mesh.comm,
        interfaces=given,
        bcs=conditions,
        loads=loads,
        potential=potential,
        geometry=geometry,
        **options,
    )
    check("geometry", geometry, one_of(*GEOMETRIES))
    a_list = instance(Iterable, "give a list, [] for none")
    sides: list[Interface] = list(check("interfaces", given, a_list))
    for k, interface in enumerate(sides):
        check(f"interfaces[{k}]", interface, instance(Interface, "give Contact or Tie objects"))
        if any(interface is other for other in sides[:k]):
            raise ValueError(f"interfaces holds the same object {interface!r} twice: give it once")
    if sides:
        _check_weight(solid)
    conditions = check_conditions("bcs", list(check("bcs", conditions, a_list)), solid.V)
    finite = np.isfinite(solid.V.mesh.geometry.x).all()
    if any_rank(solid.V.mesh.comm, not finite)[0]:
        raise ValueError("the mesh's coordinates hold NaN or infinity; check the mesh")
    return sides, conditions


def check_problem(problem: Any, kind: type) -> None:
    """Raise a ValueError unless a problem is of its class."""
    remedy = f"give a {kind.__name__}(solid, interfaces, bcs=...)"
    check("problem", problem, instance(kind, remedy))


def check_controls(qp: Any, rtol: Any, max_it: Any) -> None:
    """Raise a ValueError for invalid controls of Newton's method."""
    backends.check_name(qp)
    check("rtol", rtol, number(above=0.0, below=1.0))
    check("max_it", max_it, integer(1))


def check_load_steps(
    comm: MPI.Comm, times: Any, start: Any, max_cuts: Any, cuts: Any
) -> list[float]:
    """Checked load levels, see `load_steps`; collective."""
    levels = _unrolled(times)
    check_same_on_all_ranks(comm, times=levels, start=start, max_cuts=max_cuts, cuts=cuts)
    for level in check("times", levels, instance(list, "give a list of levels, [1.0] for one")):
        check("times: a level", level, NUMBER)
    check_optional("start", start, number("the finite level of the committed state"))
    check("max_cuts", max_cuts, integer(0))
    check("cuts", cuts, one_of(*CUTS))
    return [float(level) for level in levels]


def check_every(comm: MPI.Comm, checkpoint: Any, every: Any) -> Path | None:
    """Checked checkpoint file, or None; collective."""
    given = None if checkpoint is None else "a file"
    check_same_on_all_ranks(comm, every=every, checkpoint=given)
    check("every", every, integer(1))
    if given:
        return check_path(comm, checkpoint, "checkpoint")
    if every != 1:
        raise ValueError(f"every is {every!r}, but there is no checkpoint: give its file")
    return None


def _unrolled(values: Any) -> Any:
    values = values.tolist() if isinstance(values, np.ndarray) else values
    text = isinstance(values, str | bytes)
    return list(values) if isinstance(values, Iterable) and not text else values


def _check_weight(solid: Solid) -> None:
    x = np.array(solid.mesh.geometry.x[:, : solid.mesh.geometry.dim], dtype=np.float64)
    i = solid.kinematics.radius
    if i is not None:
        x[:, i] = np.abs(x[:, i])
    with raised_together(solid.mesh.comm):
        solid.kinematics.weights_at(x)


def check_conditions(name: str, bcs: Sequence[Any], V: fem.FunctionSpace) -> list[fem.DirichletBC]:
    """Checked Dirichlet conditions on V."""
    for bc in bcs:
        remedy = "make it with dolfinx.fem.dirichletbc"
        check(f"{name}: one", bc, instance(fem.DirichletBC, remedy))
        space = bc.function_space
        if not V._cpp_object.contains(getattr(space, "_cpp_object", space)):
            raise ValueError(
                f"{name} holds a condition on another space than that of solid.u: make it on "
                "u.function_space or a component, u.function_space.sub(i)"
            )
        if not type(bc._cpp_object).__name__.endswith("float64"):
            raise ValueError(
                f"{name} holds a condition with values that are not real: give numbers, "
                "Constants or Functions of type float64"
            )
    return list(bcs)
