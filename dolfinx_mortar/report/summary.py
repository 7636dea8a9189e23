# SPDX-License-Identifier: MIT
"""Numbers of load steps as rows of a table or JSON file."""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.common.step_report import LoadStep
from dolfinx_mortar.problem.checks import check_problem
from dolfinx_mortar.problem.problem import ContactProblem


def summarise(step: LoadStep) -> dict[str, Any]:
    """Costs, residuals, forces and notes of a load step as a dictionary.

        rows = [dm.summarise(step) | {"gap": gap()} for step in dm.load_steps(...)]

    Returns:
        "time"; "parts" (more than one after cuts); over all parts "newton_iterations",
        "qp_iterations", "linear_iterations", "factorisations", "residual_history", "notes" and this
        rank's "seconds"; of the last part "linear_solver", "certificate" and the "ledger" of
        `time_steps`, else None; "forces" on the slave side of each interface; "reactions", "force"
        and "moment" about the origin of each of ``problem.bcs``.
    """
    check("step", step, instance(LoadStep, "give a LoadStep, such as load_steps yields"))
    parts, last = step.parts, step.report.as_dict()
    iterations = [iteration for part in parts for iteration in part.iterations]
    work = sorted({name for part in parts for name in part.seconds})
    return {
        "time": step.time,
        "parts": len(parts),
        "newton_iterations": len(iterations),
        "qp_iterations": sum(part.qp_iterations for part in parts),
        "linear_iterations": sum(iteration.linear_iterations for iteration in iterations),
        "factorisations": sum(part.factorisations for part in parts),
        "residual_history": [r for part in parts for r in part.residual_history],
        "notes": [note for part in parts for note in part.notes],
        "seconds": {name: sum(part.seconds.get(name, 0.0) for part in parts) for name in work},
        **{name: last[name] for name in ("linear_solver", "certificate", "ledger")},
        "forces": step.forces,
        "reactions": step.reactions,
    }


def write_summary(
    path: str | os.PathLike[str],
    problem: ContactProblem,
    steps: Sequence[Mapping[str, Any]],
    **more: Any,
) -> None:
    """Write the size of a problem and a row for every load step as JSON; collective.

    Rank 0 writes. Arrays become lists, non-finite numbers null, unknown objects text.

    Args:
        path: file in an existing folder.
        problem: gives "dofs", "cells", "ranks", and rank 0's "seconds".
        steps: rows such as those of ``summarise``.
        more: further entries.

    Errors are raised on all ranks.
    """
    check_problem(problem, ContactProblem)
    path = check_path(problem.comm, path)
    wanted = "give a list of rows, [dm.summarise(step) for step in ...]"
    with raised_together(problem.comm):
        for row in check("steps", steps, instance((list, tuple), wanted)):
            check("steps: a row", row, instance(Mapping, wanted))
    V, comm = problem.solid.V, problem.comm
    size = {
        "dofs": V.dofmap.index_map.size_global * V.dofmap.index_map_bs,
        "cells": V.mesh.topology.index_map(V.mesh.topology.dim).size_global,
        "ranks": comm.size,
        "seconds": problem.timings.seconds,
    }
    with raised_together(comm):
        if comm.rank == 0:
            text = json.dumps(size | more | {"steps": steps}, default=_plain)
            finite = json.loads(text, parse_constant=lambda name: None)
            try:
                Path(path).write_text(json.dumps(finite, indent=1))
            except OSError as error:
                said = error.strerror or str(error)
                raise OSError(f"path is {os.fspath(path)!r}: {said}") from error


def _plain(value: Any) -> Any:
    """Arrays as lists, mappings as dictionaries, others as text."""
    if isinstance(value, Mapping):
        return dict(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
