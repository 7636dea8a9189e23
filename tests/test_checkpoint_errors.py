# SPDX-License-Identifier: MIT
"""Checkpoints that are invalid or cannot be written: an error on all ranks, and no change."""

import os
import re
import shutil
import sys

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.persistence import checkpoints
from dolfinx_mortar.persistence.checkpoints import HEAD, material_numbers
from dolfinx_mortar.shapes import Cylinder
from tests import tool_case
from tests.cases.pressed_blocks import rejected
from tests.checkpoint_program import STEEL, Press

COMM = MPI.COMM_WORLD
LEVELS = [0.5]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Return a checkpoint."""
    file = COMM.bcast(tmp_path_factory.mktemp("checkpoint") / "good.h5")
    list(Press().walk(LEVELS, checkpoint=file, rtol=1e-6))
    return file


@pytest.fixture(scope="module")
def press():
    """Return a problem that takes over no checkpoint of this module."""
    return Press()


def changed(good, folder, change):
    """Return a copy that rank 0 has changed."""
    file = folder / "bad.h5"
    if COMM.rank == 0:
        shutil.copy(good, file)
        change(file)
    COMM.barrier()
    return file


def refused(press, file, *words, error=ValueError):
    """Expect that neither a problem nor a walk takes over a file, and stay as they were."""
    with rejected(str(file), *words, error=error):
        press.problem.restore(file)
    if error is ValueError:
        with rejected(str(file), *words):
            next(press.walk(LEVELS, checkpoint=file))
    assert not press.problem.u.x.array.any() and not press.problem.history


# -- files


@pytest.mark.mpi
def test_no_file(press, folder):
    refused(press, folder / "none.h5", "there is no such checkpoint", error=OSError)


def other_head(change):
    """Return what makes another word of the first line, whatever the lines behind it then mean."""

    def make(file):
        old = rf"{change.split()[0]} [\d.]+".encode()
        file.write_bytes(re.sub(old, change.encode(), file.read_bytes(), count=1))

    return make


def unfinished(file):
    """Leave a draft as it is before it gets its head, under the name of a checkpoint."""
    with file.open("r+b") as raw:
        raw.write(bytes(HEAD))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda file: file.write_text("time, force\n"), ["no checkpoint"]),
        (lambda file: h5py.File(file, "w").close(), ["no checkpoint"]),
        (unfinished, ["before it was complete", "take the last complete one"]),
        *(
            (other_head(c), [c, "with the version that has written it"])
            for c in ("format 8", "format 11", "version 0.0")
        ),
    ],
)
def test_another_kind_of_file(press, good, folder, change, words):
    refused(press, changed(good, folder, change), *words)
    refused(press, folder, "no checkpoint")


# -- problems


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"jitter": 0.41}, ["nodes: ", "are in the checkpoint not at all, ", "such as that at ("]),
        (
            {"law": dm.Elastic(1e5, 0.3)},
            ["solid: materials is 'Elastic', in the checkpoint 'VonMises'"],
        ),
        (
            {"law": dm.VonMises(E=206_900.0, nu=0.29, Y=400.0, a=10_000.0)},
            ["material 0, VonMises: Y is 400.0, in the checkpoint 367.4"],
        ),
        (
            {"surface": "facets"},
            ["problem: interfaces is \"Contact(slave=3, master=4, surface='facets')\", in"],
        ),
        ({"geometry": "reference"}, ["problem: geometry is 'reference', in", "'updated'"]),
    ],
)
def test_another_problem(good, options, words):
    refused(Press(**options), good, "a checkpoint of another problem", *words)


@pytest.mark.mpi
def test_the_same_materials_in_other_cells(folder, monkeypatch):
    """As many cells of each, of which one on rank 0 has been exchanged."""
    one = Press(law={1: STEEL, 2: dm.Elastic(1e5, 0.3)})
    one.problem.save(folder / "x.h5")
    numbers = material_numbers(one.problem.solid)
    first = [np.flatnonzero(numbers == k)[:1] if COMM.rank == 0 else [] for k in range(2)]
    for k, at in enumerate(first):
        numbers[at] = 1 - k
    monkeypatch.setattr(checkpoints, "material_numbers", lambda solid: numbers)
    count = COMM.bcast(sum(map(len, first)))
    with rejected(f"another problem: solid: {count} integration points have another material"):
        one.problem.restore(folder / "x.h5")


def with_tool(shape, **options):
    """Return a problem with a tool of a shape, and a rigid side with a point."""
    block = tool_case.Block(n=3)
    point = options.pop("point", [0.0, -10.0])
    base = dm.RigidSide(block.facets, tool_case.BASE, reference=point)
    tool = block.tool(shape, friction=0.3, **options)
    return block.problem([base, tool], bcs=())


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("shape", "options", "word"),
    [
        (Cylinder([0.0, 8.0], 8.0), {}, ""),
        (Cylinder([0.0, 8.0], 7.0), {}, "distances"),
        (Cylinder([0.0, 8.0], 8.0), {"point": [5.0, -10.0]}, "reference"),
        (Cylinder([0.0, 8.0], 8.0), {"reference": [0.0, 0.0]}, "reference"),
    ],
)
def test_another_tool(folder, shape, options, word):
    """Its shape and its point belong to the slips, forces and positions of a checkpoint."""
    with_tool(Cylinder([0.0, 8.0], 8.0)).save(folder / "tool.h5")
    problem = with_tool(shape, **options)
    if word:
        with rejected("a checkpoint of another problem: interfaces[", f"{word} is off by up to "):
            problem.restore(folder / "tool.h5")
    else:
        problem.restore(folder / "tool.h5")


# -- arguments


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"checkpoint": 3}, ["checkpoint is 3", "give the name of a file"]),
        ({"checkpoint": "x.h5", "every": 0}, ["every is 0", "an integer >= 1"]),
        ({"checkpoint": "x.h5", "every": True}, ["every is True", "an integer"]),
        ({"every": 2}, ["every is 2", "there is no checkpoint"]),
    ],
)
def test_arguments_of_a_walk(press, given, words):
    with rejected(*words):
        next(press.walk(LEVELS, **given))
    assert not press.problem.u.x.array.any()


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["x" * 252, "pipe", ".", "none/x.h5"])
def test_names_under_which_no_checkpoint_can_be_written(press, folder, name):
    """Too long for the draft, in use for what is no file, or in no folder; told before a step."""
    if COMM.rank == 0:
        os.mkfifo(folder / "pipe")
    COMM.barrier()
    words = "cannot be written", "existing, writable folder"
    with rejected(*words, error=OSError):
        press.problem.save(folder / name)
    if name not in ("pipe", "."):
        with rejected(*words, error=OSError):
            next(press.walk(LEVELS, checkpoint=folder / name))
    assert [path.name for path in folder.iterdir()] == ["pipe"]
    assert not press.problem.u.x.array.any()


@pytest.mark.mpi
def test_a_writer_and_a_checkpoint_of_one_name(good, folder):
    """The numbers of run.xdmf are in run.h5: neither replaces the other, whoever comes first."""
    press, file = Press(), folder / "run.h5"
    with dm.Writer(folder / "run.xdmf", press.problem, resume=True) as out:
        out.write(1.0)
        content = COMM.bcast(file.read_bytes())
        words = str(file), "no checkpoint, and would be replaced", "choose a file in"
        with rejected(*words, error=OSError):
            press.problem.save(file)
        with rejected(str(file), "no checkpoint"):
            next(press.walk(LEVELS, checkpoint=file))
        assert file.read_bytes() == content
    COMM.barrier()
    if COMM.rank == 0:
        (folder / "run.xdmf").unlink()
        shutil.copy(good, file)
    COMM.barrier()
    with rejected("run.xdmf", str(file), "is a checkpoint; choose another name"):
        dm.Writer(folder / "run.xdmf", press.problem, resume=False)
    assert file.read_bytes() == good.read_bytes()


# -- what goes wrong while writing


@pytest.mark.mpi
@pytest.mark.parametrize("work", ["common.disk.demand_space", "persistence.checkpoints.seal"])
def test_a_disk_that_fails(good, folder, monkeypatch, work):
    """Rank 0 takes what the others send, and all are told; the last checkpoint stays."""
    file, press = changed(good, folder, lambda file: None), Press()

    def fail(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(f"dolfinx_mortar.{work}", fail)
    with rejected("could not be written", "no space left", error=OSError):
        press.problem.save(file)
    assert file.read_bytes() == good.read_bytes()
    assert [path.name for path in folder.iterdir()] == ["bad.h5"]
    monkeypatch.undo()
    press.problem.save(file)
    press.problem.restore(file)


@pytest.mark.mpi
def test_without_h5py(press, folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    error = ImportError if COMM.rank == 0 else RuntimeError
    with rejected("checkpoints need h5py", "pip install", error=error):
        next(press.walk(LEVELS, checkpoint=folder / "x.h5"))
