# SPDX-License-Identifier: MIT
"""A file that a run goes on with after a checkpoint holds every step once, whatever stopped it."""

import logging
import sys
import xml.etree.ElementTree as ET
from functools import partial

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.output.writer import Step, insert
from tests import checkpoint_program
from tests.cases.pressed_blocks import rejected

meshio = pytest.importorskip("meshio")
pytest.importorskip("h5py")

COMM = MPI.COMM_WORLD
OPTIONS = {"rtol": 1e-8, "progress": False}
# what is solved does not matter here
Press = partial(checkpoint_program.Press, law=dm.Elastic(206_900.0, 0.29), geometry="reference")


def run(folder, press=None, *, stop=None, before=False, every=1):
    """Run the program of a user; leave it at a step, before or after that has been written."""
    press = Press() if press is None else press
    with dm.Writer(folder / "out.xdmf", press.problem, resume=True) as out:
        out.write(0)  # nothing has been restored yet
        walk = press.walk(checkpoint=folder / "run.h5", every=every, **OPTIONS)
        for step in walk:
            if before and step.number == stop:
                sys.exit()
            out.write(len(press.problem.history))
            if step.number == stop:
                sys.exit()
    COMM.barrier()


def stopped(folder, **options):
    """Run until somebody leaves."""
    with pytest.raises(SystemExit):
        run(folder, **options)
    COMM.barrier()


def content(folder):
    """Return the times in the file, and the displacements there, in the order of the places."""
    found = []
    with meshio.xdmf.TimeSeriesReader(folder / "out.xdmf") as reader:
        reader.read_points_cells()
        for k in range(reader.num_steps):
            time, nodes, _ = reader.read_data(k)
            points = reader._read_data_item(reader.collection[k].find("Geometry")[0])
            table = np.hstack([points, nodes["displacement"]])
            found.append((time, table[np.lexsort(np.round(table, 9).T[::-1])]))
    COMM.barrier()
    return found


def same(found, expected):
    """Compare the content of two files."""
    assert [time for time, _ in found] == [time for time, _ in expected]
    for (time, a), (_, b) in zip(found, expected, strict=True):
        assert np.abs(a - b).max() <= 1e-10, time


@pytest.fixture(scope="module")
def at_once(tmp_path_factory):
    """Return what a run that nothing stops leaves."""
    folder = COMM.bcast(tmp_path_factory.mktemp("once"))
    run(folder)
    found = content(folder)
    assert [time for time, _ in found] == [0, 1, 2, 3, 4]
    return found


@pytest.mark.mpi
@pytest.mark.parametrize(("before", "every"), [(True, 1), (False, 2)])
def test_a_step_is_neither_lost_nor_there_twice(folder, at_once, before, every):
    """Left in step 3, of which the checkpoint knows nothing; and in step 2 of the second run."""
    stopped(folder, stop=3, before=before, every=every)
    same(content(folder), at_once[: 3 if before else 4])
    stopped(folder, stop=4, before=before, every=every)
    run(folder, every=every)
    same(content(folder), at_once)


@pytest.mark.mpi
def test_who_begins_anew_mixes_nothing(folder, at_once):
    """Without the checkpoint all steps are made again; those of the last run go with the first."""
    run(folder)
    COMM.barrier()
    if COMM.rank == 0:
        (folder / "run.h5").unlink()
    COMM.barrier()
    stopped(folder, stop=1)
    same(content(folder), at_once[:2])


@pytest.mark.mpi
def test_the_mesh_of_each_step(folder, at_once, caplog):
    """Each run has a mesh of its own, and says so to those who read the first one only."""
    stopped(folder, stop=3)
    with caplog.at_level(logging.WARNING, logger="dolfinx_mortar"):
        run(folder, Press("stripes"))
    same(content(folder), at_once)
    grids = ET.parse(folder / "out.xdmf").getroot().findall("Domain/Grid/Grid")
    meshes = {grid.find("Geometry")[0].text for grid in grids}
    assert len(meshes) == 2
    assert ("each run has a mesh of its own" in caplog.text) == (COMM.rank == 0)
    assert {p.name for p in folder.iterdir()} == {"out.xdmf", "out.h5", "out.2.h5", "run.h5"}


@pytest.mark.mpi
def test_what_cannot_be_resumed(folder):
    press, path = Press(), folder / "out.xdmf"
    with rejected("resume is 1: give True or False"):
        dm.Writer(path, press.problem, resume=1)
    dm.Writer(path, press.problem, resume=True).close()  # nothing to resume: a new one
    for text in (
        "",
        "<Xdmf>",
        "<Xdmf/>",
        "<Xdmf><Domain><Grid Name='mesh'/></Domain></Xdmf>",
        "<Xdmf><Domain><Grid Name='steps'><Grid/></Grid></Domain></Xdmf>",
    ):
        COMM.barrier()
        if COMM.rank == 0:
            path.write_text(text)
        COMM.barrier()
        with rejected("out.xdmf", "cannot be resumed", "give another name"):
            dm.Writer(path, press.problem, resume=True)
        assert path.read_text() == text
    COMM.barrier()
    with dm.Writer(path, press.problem) as out:
        out.write(1.0)
    COMM.barrier()
    if COMM.rank == 0:
        (folder / "out.h5").unlink()
    COMM.barrier()
    with rejected("out.xdmf", "out.h5 with its numbers is gone", "give another name"):
        dm.Writer(path, press.problem, resume=True)


def step(done, time, earlier=True):
    return Step(ET.Element("Grid"), done, time, earlier)


@pytest.mark.parametrize(
    ("old", "new", "made", "left"),
    [
        # between two walks a state has been restored and nothing made: a later one may come
        ([(0, 0), (4, 4), (5, 5)], (4, 4), False, [0, 4, 5]),
        ([(0, 0), (4, 4), (5, 5)], (4, 4), True, [0, 4]),
        # without load steps times alone tell what comes first
        ([(0, 1), (0, 2), (0, 3)], (0, 2.5), False, [1, 2, 2.5]),
        ([(1, 1), (2, 2)], (3, 2), True, None),
        ([(1, 1), (2, 2)], (3, 1.5), True, None),
    ],
)
def test_what_gives_way(old, new, made, left):
    given = [step(*one) for one in old], step(*new, earlier=False)
    if left is None:
        with rejected(f"t is {new[1]}", "times have to rise"):
            insert(*given, made=made)
    else:
        assert [one.time for one in insert(*given, made=made)] == left
