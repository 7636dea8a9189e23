# SPDX-License-Identifier: MIT
"""The progress of load steps: when it shows, what it leaves alone."""

import io
import logging
import re
import sys
from contextlib import suppress

from mpi4py import MPI

import pytest

from dolfinx_mortar.steps.progress import progress
from dolfinx_mortar.steps.report import LoadStep, StepReport

ERASE, UP = "\x1b[2K", "\x1b[1A"
HIDE, BACK = "\x1b[?25l", "\x1b[?25h"  # the cursor
LINES = "".join(
    f"load step {i} of 2 to 0.{i}: 0 Newton iterations, 0 nodes in contact\n" for i in (1, 2)
)


def step(number):
    """Return a step that has cost nothing."""
    return LoadStep(number, number / 10, StepReport(), [StepReport()])


class Screen(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True

    def shown(self):
        """Return the lines that are left of all that was written and erased."""
        lines, row = [""], 0
        for part in re.findall(r"\x1b\[[?\d]*[A-Za-z]|[\r\n]|[^\x1b\r\n]+", self.getvalue()):
            if part == "\n":
                row += 1
                lines += [""] * (row == len(lines))
            elif part == UP:
                row -= 1
            elif part == ERASE:
                lines[row] = ""
            elif part[0] not in "\x1b\r":
                lines[row] += part
        return lines


@pytest.fixture
def streams(monkeypatch):
    """Return a function that replaces both standard streams."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.delenv("FORCE_COLOR", raising=False)

    def replace(out=True, err=True):
        made = [Screen() if terminal else io.StringIO() for terminal in (out, err)]
        monkeypatch.setattr(sys, "stdout", made[0])
        monkeypatch.setattr(sys, "stderr", made[1])
        return made

    return replace


@pytest.fixture
def no_rich(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "rich"] + ["rich"]:
        monkeypatch.setitem(sys.modules, name, None)


@pytest.fixture
def nobody_logs(monkeypatch):
    """Hide the handlers that the tests have."""
    monkeypatch.setattr("dolfinx_mortar.steps.progress.is_configured", lambda: False)


def walk(total=2, wanted=None, comm=MPI.COMM_SELF, done=0):
    with progress(comm, total, wanted, done=done) as advance:
        for number in range(done + 1, total + 1):
            advance(step(number))


@pytest.mark.usefixtures("nobody_logs")
@pytest.mark.parametrize(("out", "err"), [(True, False), (False, True), (False, False)])
def test_a_file_gets_a_line_for_each_step(streams, out, err):
    """Also under a scheduler, and where one of the streams goes through a pipe."""
    both = streams(out, err)
    walk()
    assert [stream.getvalue() for stream in both] == ["", LINES]


@pytest.mark.usefixtures("nobody_logs")
@pytest.mark.parametrize("out", [True, False])
def test_one_step_needs_no_line(streams, out):
    both = streams(out, out)
    walk(1)
    assert [stream.getvalue() for stream in both] == ["", ""]


@pytest.mark.usefixtures("nobody_logs")
@pytest.mark.parametrize(("wanted", "shown"), [(None, ""), (True, LINES)])
def test_a_notebook_stays_clean_unless_asked(streams, monkeypatch, wanted, shown):
    streams(False, False)
    cell = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})()
    monkeypatch.setattr(sys, "stderr", cell)
    walk(wanted=wanted)
    assert cell.getvalue() == shown


@pytest.mark.parametrize("wanted", [None, True])
def test_where_logging_is_configured_lines_are_records(streams, monkeypatch, caplog, wanted):
    """They are not written twice, and not at all where the user's level is higher."""
    _, err = streams(False, False)
    with caplog.at_level(logging.INFO, logger="dolfinx_mortar"):
        walk(wanted=wanted)
    assert [record.getMessage() for record in caplog.records] == LINES.splitlines()
    assert {record.levelname for record in caplog.records} == {"INFO"} and err.getvalue() == ""
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="dolfinx_mortar"):
        walk(wanted=wanted)
    assert not caplog.records and err.getvalue() == (LINES if wanted else "")


def test_the_log_has_the_steps_of_a_bar(streams, caplog):
    streams()
    with caplog.at_level(logging.INFO, logger="dolfinx_mortar"):
        walk()
    assert [record.getMessage() for record in caplog.records] == LINES.splitlines()


def test_steps_of_an_earlier_run_are_done(streams):
    _, err = streams()
    walk(5, done=3)
    assert "3/5" in err.getvalue() and "4/5" in err.getvalue() and "0/5" not in err.getvalue()


def test_two_terminals_show_a_bar_and_lose_it(streams):
    out, err = streams()
    walk()
    drawn = [line for line in err.getvalue().split(ERASE) if "load steps" in line]
    for done, line in enumerate(drawn[-4:-1]):  # the last one is drawn again to be erased
        assert f"{done}/2" in line
    assert not any(err.shown()) and out.getvalue() == ""


@pytest.mark.parametrize("wanted", [None, True])
def test_a_bar_leaves_lines_streams_and_handlers_alone(streams, monkeypatch, wanted):
    out, err = streams()
    handler, logger = logging.StreamHandler(err), logging.getLogger("dolfinx_mortar")
    monkeypatch.setattr(logger, "handlers", [handler])
    monkeypatch.setattr(logger, "level", logging.INFO)
    told = [f"iteration {i}" for i in range(6)]
    with progress(MPI.COMM_SELF, 3, wanted) as advance:
        for number in range(3):
            logger.info(told[2 * number])
            assert handler.stream is err and (sys.stdout, sys.stderr) == (out, err)
            advance(step(number + 1))
            logger.info(told[2 * number + 1])
    assert "load steps" in err.getvalue()
    lines = [line for line in err.shown() if "iteration" in line]
    assert [line[-len(told[0]) :] for line in lines] == told


def test_an_error_gives_the_terminal_back(streams):
    _, err = streams()
    with suppress(ZeroDivisionError), progress(MPI.COMM_SELF, 2, True) as advance:
        advance(step(1))
        raise ZeroDivisionError
    assert err.getvalue().rindex(HIDE) < err.getvalue().rindex(BACK)
    assert not any(err.shown())


def test_asked_for_without_a_terminal_it_is_a_line_for_each_step(streams):
    out, err = streams(False, False)
    walk(wanted=True)
    assert (out.getvalue(), err.getvalue()) == ("", LINES)


@pytest.mark.usefixtures("no_rich")
def test_without_rich_it_is_a_line_for_each_step(streams):
    _, err = streams()
    walk()
    assert err.getvalue() == LINES


def test_not_wanted_nothing_shows(streams):
    both = streams()
    walk(wanted=False)
    assert [stream.getvalue() for stream in both] == ["", ""]


@pytest.mark.mpi
def test_only_rank_0_shows(streams):
    _, err = streams(False, False)
    walk(wanted=True, comm=MPI.COMM_WORLD)
    assert err.getvalue() == (LINES if MPI.COMM_WORLD.rank == 0 else "")


@pytest.mark.mpi
def test_what_is_neither_wanted_nor_not_is_an_error():
    comm = MPI.COMM_WORLD
    with pytest.raises(ValueError, match=r"progress is 'yes': choose True, False or None"):
        progress(comm, 2, "yes")
    with pytest.raises(ValueError, match=r"progress is 'yes': choose True, False or None"):
        progress(comm, 2, "yes" if comm.rank == comm.size - 1 else None)
