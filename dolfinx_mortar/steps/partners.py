# SPDX-License-Identifier: MIT
"""From which points of the masters the slips of a step are measured, whatever was tried before."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from petsc4py import PETSc

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.partners import Partners
from dolfinx_mortar.interfaces.system import InterfaceSystem


def partners_at(
    system: InterfaceSystem,
    u: fem.Function,
    began: Floats,
    x: PETSc.Vec,
    update: Callable[[], object] | None,
    *,
    here: bool,
) -> tuple[Sequence[Partners | None], bool]:
    """Return the partners that slave nodes have where a step begins; collective.

    Args:
        system: the interfaces.
        u: the displacement, which is as before afterwards.
        began: (n,) displacement at which the partners are found.
        x: (n,) positions at the last commit, from which slips count.
        update: rebuilds the geometry at u; None for frozen geometry, where partners stay.
        here: whether the geometry is that of u.

    Returns:
        The partners of each interface, none without friction, and whether the geometry has been
        rebuilt, at ``began``.
    """
    if not system.has_friction:
        return [], False
    if update is None:
        return [None] * len(system.interfaces), False
    present = u.x.array.copy()
    differs = (present[: began.size] != began).any()
    away = not here or bool(any_rank(u.function_space.mesh.comm, differs)[0])
    if away:
        u.x.array[: began.size] = began
        u.x.scatter_forward()
        update()
    found = system.partners(x)
    u.x.array[:] = present
    return found, away
