# SPDX-License-Identifier: MIT
"""Checkpoints: jobs that were killed end in the same numbers, on the same or on other ranks."""

import json
import signal
import xml.etree.ElementTree as ET

import pytest

from tests.checkpoint_program import Press
from tests.checkpoint_runs import agree, numbers_at_once, run


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
        *(("step", 2, 3), ("send", 3, 2), ("send", 2, 1)),
        *(
            pytest.param(*at, marks=pytest.mark.nightly)
            for at in (("write", 2, 3), ("replace", 3, 2))
        ),
    ],
)
def test_a_job_of_several_ranks_that_is_killed_goes_on(tmp_path, at_once, moment, before, after):
    """On other ranks; the rows that the others had written come to nothing."""
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
