# SPDX-License-Identifier: MIT
"""Lines that say how far a walk or a search has come: in the log, or on the error stream."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable

from mpi4py import MPI

from dolfinx_mortar.algebra.errors import raised_together

log = logging.getLogger(__name__)


def lines(comm: MPI.Comm, wanted: bool | None) -> Callable[[str], None]:
    """Return what logs a line on rank 0 and, if wanted, prints it unless the log shows it.

    Args:
        comm: ranks that work together.
        wanted: None prints where nobody has configured logging, as in most batch jobs, but not in
            notebooks, whose cells the lines would fill.

    Raises:
        ValueError: on all ranks, if ``wanted`` is none of the three on any; collective.
    """
    with raised_together(comm):
        if not (wanted is None or isinstance(wanted, bool)):
            raise ValueError(f"progress is {wanted!r}: choose True, False or None")
    if comm.rank != 0:
        return lambda line: None
    notebook = type(sys.stderr).__module__.partition(".")[0] == "ipykernel"
    shown = not (log.hasHandlers() or notebook) if wanted is None else wanted

    def tell(line: str) -> None:
        log.info("%s", line)
        if shown and not (log.hasHandlers() and log.isEnabledFor(logging.INFO)):
            print(line, file=sys.stderr, flush=True)

    return tell
