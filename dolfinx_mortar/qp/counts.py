# SPDX-License-Identifier: MIT
"""What the linear solver counts, for reports and benchmarks."""

from dataclasses import dataclass


@dataclass
class LinearCounts:
    """What the solver has done so far."""

    symbolic: int = 0  # analyses of a pattern
    factorisations: int = 0  # numeric factorisations or preconditioner set-ups
    iterations: int = 0  # applications of the factorisation or preconditioner
    solves: int = 0
    breakdowns: int = 0  # old set-ups with which an iteration failed
    seconds_factor: float = 0.0
    seconds_solve: float = 0.0
