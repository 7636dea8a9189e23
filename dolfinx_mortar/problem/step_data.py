# SPDX-License-Identifier: MIT
"""The data of a step, read once at its start."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.interfaces.slip_partners import Partners


@dataclass(frozen=True)
class StepData:
    """Dirichlet values of a step, read at its start."""

    target: Floats  # (n,) prescribed displacements, 0 where there is none
    asked: Floats  # (owned nodes, d) prescribed minus present values at the start
    increment: float  # the largest of them, and of the changes of jumps, all ranks
    # initial guess: closed contacts (owned nodes,) and slip directions (owned nodes, d)
    contacts: tuple[Bools, Floats | None] = (np.zeros(0, dtype=bool), None)
    # with friction, for each interface: limits (owned nodes,), and the points of the master from
    # which slips are measured, None for the present ones
    limits: Sequence[Floats | None] = ()
    partners: Sequence[Partners | None] = ()
    # whether what has changed makes bodies flow, so that the committed state is linearised
    flows: bool = False
    begun: Floats = field(default_factory=lambda: np.zeros(0))  # (n,) u before it was predicted
    travel: Floats | None = None  # (m,) by which tools were moved then; None where u was not
