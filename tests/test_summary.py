# SPDX-License-Identifier: MIT
"""Rows of load steps and the file that holds them."""

import json
from dataclasses import fields

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.common.step_report import Iteration, StepReport
from tests.cases.pressed_blocks import PressedBlocks


def part(*increments, **options):
    """Return a report with an iteration for each increment: 2 QP, 3 linear iterations, 1 set-up."""
    none = {field.name: 0 for field in fields(Iteration)}
    counts = {"updates": 2, "linear_iterations": 3, "factorisations": 1}
    iterations = [Iteration(**none | counts | {"increment": value}) for value in increments]
    return StepReport(iterations=iterations, **options)


@pytest.mark.mpi
def test_a_row_adds_up_the_parts_of_a_step():
    first = part(1.0, 0.5, notes=["first"], seconds={"total": 1.0, "mortar": 0.25})
    last = part(0.1, notes=["last"], seconds={"total": 2.0}, linear_solver="cg")
    row = dm.summarise(dm.LoadStep(3, 0.7, last, [first, last]))
    assert (row["time"], row["parts"], row["linear_solver"]) == (0.7, 2, "cg")
    counts = ("newton_iterations", "qp_iterations", "linear_iterations", "factorisations")
    assert [row[name] for name in counts] == [3, 6, 9, 3]
    assert row["residual_history"] == [1.0, 0.5, 0.1] and row["notes"] == ["first", "last"]
    assert row["seconds"] == {"total": 3.0, "mortar": 0.25}


@pytest.mark.mpi
def test_a_summary_is_strict_json(folder):
    case = PressedBlocks()
    problem = case.problem()
    (step,) = dm.load_steps(problem, [1.0])
    path = folder / "summary.json"
    row = dm.summarise(step) | {"fit": np.nan, "n": np.int32(2)}
    row["force"] = problem.interfaces[0].force
    dm.write_summary(path, problem, [row], options={"output": path})
    case.mesh.comm.barrier()
    back = json.loads(path.read_text(), parse_constant=lambda word: pytest.fail(word))
    nodes = case.V.dofmap.index_map.size_global
    assert (back["dofs"], back["ranks"]) == (2 * nodes, case.mesh.comm.size)
    assert back["cells"] == case.mesh.topology.index_map(2).size_global
    assert back["options"] == {"output": str(path)} and back["seconds"]["assembly"] > 0.0
    (found,) = back["steps"]
    assert found["fit"] is None and found["n"] == 2 and len(found["force"]) == 2
    assert found["newton_iterations"] == step.report.newton_iterations
    assert found["certificate"] == step.report.as_dict()["certificate"]


@pytest.mark.mpi
def test_a_file_that_cannot_be_written_is_an_error_on_all_ranks(folder):
    problem = PressedBlocks().problem()
    with pytest.raises(OSError, match=r"path is '.*missing/summary.json': No such file"):
        dm.write_summary(folder / "missing" / "summary.json", problem, [])
    for wrong in (None, "a\0b"):  # an error of one rank must not leave the others waiting
        with pytest.raises((TypeError, ValueError, RuntimeError)):
            dm.write_summary(wrong, problem, [])
