# SPDX-License-Identifier: MIT
"""Checkpoints: a run that was stopped ends in the same numbers, on any number of ranks."""

import json
import signal
import xml.etree.ElementTree as ET

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.steps import walk as stepping
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import largest
from tests.checkpoint_program import LEVELS, Press
from tests.checkpoint_runs import agree, numbers_at_once, run

COMM = MPI.COMM_WORLD


@pytest.mark.mpi
def test_the_state_comes_back_as_it_was(folder):
    """On another partition, in another numbering; what is shown needs no step to be there."""
    press, fresh = Press(), Press(partition="stripes")
    list(press.walk(LEVELS[:3]))
    press.problem.save(folder / "state.h5")
    fresh.problem.restore(folder / "state.h5")
    agree(fresh.numbers(), press.numbers())
    assert fresh.problem.committed.level == LEVELS[2] and fresh.problem.system.faced
    closed = [COMM.allreduce(int(c.problem.committed.active.sum())) for c in (fresh, press)]
    assert closed[0] == closed[1] > 0
    reports = [step.as_dict() for step in press.problem.history]
    # of rank 0, which has written
    assert [step.as_dict() for step in fresh.problem.history] == COMM.bcast(reports)
    assert str(fresh.problem.history[1]) == str(press.problem.history[1])
    assert dm.summarise(fresh.problem.history[1])["time"] == LEVELS[1]
    fields, expected = fresh.problem.output_fields(), press.problem.output_fields()
    for name, field in expected.items():
        sizes = [largest(f.x.array) for f in (fields[name], field)]
        assert sizes[0] == pytest.approx(sizes[1], rel=1e-12), name


@pytest.mark.slow
def test_a_walk_that_is_done_yields_nothing(folder, caplog):
    file, press, fresh = folder / "done.h5", Press(), Press()
    list(press.walk(LEVELS[:2], checkpoint=file))
    assert list(fresh.walk(LEVELS[:2], checkpoint=file)) == []
    assert COMM.rank > 0 or "2 of 2 steps are done, to 0.5; nothing is left" in caplog.text
    agree(fresh.numbers(), press.numbers())
    assert np.array_equal(fresh.top.value, press.top.value)  # on_time has been called
    # more levels may follow later, but not others before
    assert [step.number for step in fresh.walk(LEVELS[:3], checkpoint=file)] == [3]
    for others, words in (
        ([0.25, 0.6, 1.0, 0.75], r"level 2 is 0.6, but .* has 3 levels, this one 0.5:"),
        (LEVELS[:2], r"level 3 is missing, but .* this one 1.0: give times that begin so"),
    ):
        with pytest.raises(ValueError, match=words):
            list(Press().walk(others, checkpoint=file))


def test_a_run_that_is_restored_pairs_where_the_other_has(folder):
    """Pairs and claims depend on where the search was made, so a checkpoint says where."""
    press, fresh = Press(), Press()
    list(press.walk(LEVELS[:2]))
    before = press.problem.system.searches
    press.problem.save(folder / "x.h5")
    fresh.problem.restore(folder / "x.h5")
    fresh.problem.audit()
    assert fresh.problem.system.searches == 1
    fresh.problem.restore(folder / "x.h5")
    for case in (press, fresh):
        list(case.walk([0.51]))
    # the one goes on with its pairs, the other finds them again
    assert (press.problem.system.searches, fresh.problem.system.searches) == (before, 2)
    first, other = (case.problem.committed.paired for case in (press, fresh))
    assert np.array_equal(first, other)


def test_what_the_body_of_the_loop_has_not_done_is_done_again(folder):
    file, press = folder / "x.h5", Press()
    with pytest.raises(KeyError):
        for step in press.walk(LEVELS[:3], checkpoint=file):
            if step.number == 2:
                raise KeyError
    assert next(Press().walk(LEVELS[:3], checkpoint=file)).number == 2


@pytest.mark.mpi
def test_a_step_that_fails_writes_what_is_committed(folder, monkeypatch):
    """The steps before, whatever `every`, and its parts; to go on is to have walked in parts."""
    file, press, farther, fresh = folder / "x.h5", Press(), Press(), Press("stripes")
    tire(press, 0.8, monkeypatch)
    saved = count_saves(press.problem, monkeypatch)
    with rejected("from 0.75 to 0.875, after 2 of 2", error=dm.NewtonNotConverged):
        list(press.walk(checkpoint=file, every=10, max_cuts=2))
    assert saved == [(2, 0.75)]  # steps that are done, and the level that is reached
    assert [step.number for step in fresh.walk(checkpoint=file, every=10)] == [3, 4]
    list(farther.walk([0.25, 0.5, 0.75, 1.0, 0.75]))
    found, expected = fresh.numbers(), farther.numbers()
    del expected["history"][2]
    for number, row in enumerate(expected["history"], start=1):
        row[0] = number
    agree(found, expected)


def tire(press, limit, monkeypatch):
    """Let Newton fail beyond a level, as too few iterations make it."""
    solve = stepping.solve_step

    def tired(problem, **options):
        beyond = problem is press.problem and press.top.value[1] < -0.008 * limit
        return solve(problem, **options | ({"max_it": 1} if beyond else {}))

    monkeypatch.setattr(stepping, "solve_step", tired)


def count_saves(problem, monkeypatch):
    """Return the list to which each checkpoint adds the steps that are done, and the level."""
    save, saved = problem.save, []

    def counted(file):
        saved.append((problem.committed.walked, problem.committed.level))
        save(file)

    monkeypatch.setattr(problem, "save", counted)
    return saved


def test_a_step_that_is_not_committed_is_not_saved(folder):
    press = Press()
    list(press.walk(LEVELS[:1]))
    press.on_time(LEVELS[1])
    dm.newton(press.problem, rtol=1e-12)
    with rejected("problem: the last step is not committed: call problem.commit()"):
        press.problem.save(folder / "open.h5")
    press.problem.commit()
    press.problem.save(folder / "open.h5")


@pytest.mark.mpi
def test_a_state_without_results_takes_them_away(folder):
    """From those who hold them, too."""
    press = Press()
    pressure, solid = press.contact.pressure, press.problem.solid
    press.problem.save(folder / "begin.h5")
    list(press.walk(LEVELS[:2]))
    assert largest(pressure.x.array) > 0.0 and solid.max("plastic_strain_norm") > 0.0
    press.problem.restore(folder / "begin.h5")
    assert press.contact.pressure is pressure and not pressure.x.array.any()
    with pytest.raises(dm.interfaces.results.NoResult):
        _ = press.contact.force
    assert solid.max("von_mises") == solid.max("plastic_strain_norm") == 0.0
    assert not press.problem.history and not press.problem.committed.active.any()
    assert [step.number for step in press.walk(LEVELS[:1])] == [1]


# -- jobs that were killed


@pytest.fixture(scope="module")
def at_once():
    """Return the numbers of all steps in one go."""
    return numbers_at_once()


@pytest.mark.serial
@pytest.mark.parametrize(
    "moment", ["write", *(pytest.param(m, marks=pytest.mark.slow) for m in ("step", "replace"))]
)
def test_a_run_that_is_killed_goes_on(tmp_path, at_once, moment):
    """While a step is solved, a checkpoint is written, or just before it gets its name."""
    file, result = tmp_path / "run.h5", tmp_path / "result.json"
    code, output = run(1, file, result, 4, moment)
    assert code == -signal.SIGKILL and not result.exists(), output
    assert "load step 2 of 4 to 0.5: " in output  # nobody has configured logging
    assert (tmp_path / "run.h5.part").exists() == (moment != "step")
    (tmp_path / moment).unlink()
    press = Press()
    assert [step.number for step in press.walk(checkpoint=file)] == [3, 4]
    agree(press.numbers(), at_once)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.h5"]


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize(
    ("moment", "before", "after"),
    [
        *(("step", 2, 3), ("send", 3, 2)),
        *(
            pytest.param(*at, marks=pytest.mark.nightly)
            for at in (("write", 2, 1), ("replace", 3, 2))
        ),
    ],
)
def test_a_job_of_several_ranks_that_is_killed_goes_on(tmp_path, at_once, moment, before, after):
    """On other ranks; the parts of the checkpoint that all had sent come to nothing."""
    file, result = tmp_path / "run.h5", tmp_path / "result.json"
    code, output = run(before, file, result, 4, moment)
    assert code != 0 and not result.exists(), output
    (tmp_path / moment).unlink()  # so it was then
    code, output = run(after, file, result, 4)
    assert code == 0 and "2 of 4 steps are done, to 0.5; going on" in output, output
    found = json.loads(result.read_text())
    assert found.pop("made") == [3, 4]
    agree(found, at_once)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["result.json", "run.h5"]


@pytest.mark.serial
@pytest.mark.slow
def test_a_job_that_is_killed_while_it_writes_results(tmp_path):
    """The file holds the steps before, all that is in it can be read, and the next job goes on."""
    meshio = pytest.importorskip("meshio")
    file, result = tmp_path / "run.h5", tmp_path / "result.json"
    for ranks, moment, steps in ((2, "output", 2), (1, "on", 4)):
        code, output = run(ranks, file, result, 4, moment)
        assert (code == 0) == (moment == "on"), output
        times = [float(t.get("Value")) for t in ET.parse(tmp_path / "out.xdmf").iter("Time")]
        assert times == [1, 2, 3, 4][:steps]
        with meshio.xdmf.TimeSeriesReader(tmp_path / "out.xdmf") as reader:
            reader.read_points_cells()
            for k in range(steps):
                assert reader.read_data(k)[0] == times[k]
    assert json.loads(result.read_text())["made"] == [3, 4]
