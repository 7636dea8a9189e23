# SPDX-License-Identifier: MIT
"""The lines of load steps: when they are printed, what they leave alone."""

import io
import logging
import sys

from mpi4py import MPI

import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.steps.walk import lines
from tests.cases.hertz import ELASTIC, create_case, create_mesh

COMM = MPI.COMM_WORLD
TOLD = "step 1\nstep 2\n"


@pytest.fixture
def nobody_logs(monkeypatch):
    """Hide the handlers that the tests have."""
    monkeypatch.setattr(logging.Logger, "hasHandlers", lambda self: False)


def told(capsys, wanted=None, comm=MPI.COMM_SELF):
    """Return what is printed of two lines."""
    tell = lines(comm, wanted)
    for number in (1, 2):
        tell(f"step {number}")
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err


@pytest.mark.usefixtures("nobody_logs")
@pytest.mark.parametrize(("wanted", "shown"), [(None, TOLD), (False, "")])
def test_where_nobody_has_configured_logging(capsys, wanted, shown):
    assert told(capsys, wanted) == shown


@pytest.mark.usefixtures("nobody_logs")
@pytest.mark.parametrize(("wanted", "shown"), [(None, ""), (True, TOLD)])
def test_a_notebook_stays_clean_unless_asked(monkeypatch, capsys, wanted, shown):
    cell = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})()
    monkeypatch.setattr(sys, "stderr", cell)
    told(capsys, wanted)
    assert cell.getvalue() == shown


@pytest.mark.parametrize("wanted", [None, True])
def test_where_logging_is_configured_lines_are_records(capsys, caplog, wanted):
    """They are not written twice, and not at all where the user's level is higher."""
    with caplog.at_level(logging.INFO, logger="dolfinx_mortar"):
        assert told(capsys, wanted) == ""
    assert [record.getMessage() for record in caplog.records] == TOLD.splitlines()
    assert {record.levelname for record in caplog.records} == {"INFO"}
    with caplog.at_level(logging.WARNING, logger="dolfinx_mortar"):
        assert told(capsys, wanted) == (TOLD if wanted else "")


@pytest.mark.mpi
def test_only_rank_0_shows(capsys):
    assert told(capsys, True, COMM) == (TOLD if COMM.rank == 0 else "")


@pytest.mark.mpi
@pytest.mark.usefixtures("nobody_logs")
@pytest.mark.parametrize("levels", [[0.01], [0.01, 0.02]])
def test_one_load_step_needs_no_line(capsys, levels):
    case = create_case(create_mesh("graded", 0.5), ELASTIC)
    steps = list(dm.load_steps(case.problem, levels, on_time=case.press))
    expected = [f"load {step}".replace(" to", f" of {len(levels)} to", 1) for step in steps]
    shown = capsys.readouterr().err.splitlines()
    assert shown == (expected if len(levels) > 1 and COMM.rank == 0 else [])


@pytest.mark.mpi
def test_what_is_neither_wanted_nor_not_is_an_error():
    for wrong in ("yes", "yes" if COMM.rank == COMM.size - 1 else None):
        with pytest.raises(ValueError, match=r"progress is 'yes': give True or False, or None"):
            lines(COMM, wrong)


def test_reports_are_shown_as_they_are_printed():
    """In notebooks, whose cells show the representation of a value."""
    case = create_case(create_mesh("graded", 0.5), ELASTIC)
    case.press(0.01)
    for shown in (case.problem.audit(), dm.newton(case.problem)):
        assert repr(shown) == str(shown) and "\n" in repr(shown)
