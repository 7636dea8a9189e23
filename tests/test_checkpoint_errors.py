# SPDX-License-Identifier: MIT
"""Checkpoints that are invalid or cannot be written: an error on all ranks, and no change."""

import errno
import os
import re
import resource
import shutil
import sys

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar import disk
from dolfinx_mortar.persistence import tables
from dolfinx_mortar.persistence.checkpoints import describe, differences, material_numbers
from dolfinx_mortar.persistence.tables import HEAD
from dolfinx_mortar.shapes import Cylinder
from tests.cases import tool as tool_case
from tests.cases.pressed_blocks import rejected
from tests.checkpoint_program import STEEL, Press

COMM = MPI.COMM_WORLD
LAST = COMM.size - 1
LEVELS = [0.5]
KINDS = ("0, Elastic", "1, VonMises")


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Return a checkpoint."""
    file = COMM.bcast(tmp_path_factory.mktemp("checkpoint") / "good.h5")
    list(Press().walk(LEVELS, checkpoint=file, rtol=1e-6))
    return file


@pytest.fixture
def folder(tmp_path):
    """Return a folder that all ranks see."""
    return COMM.bcast(tmp_path)


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


def test_another_kind_of_file(press, good, folder):
    refused(press, folder, "no checkpoint")
    text = changed(good, folder, lambda file: file.write_text("time, force\n"))
    refused(press, text, "no checkpoint")
    other = changed(good, folder, lambda file: h5py.File(file, "w").close())
    refused(press, other, "no checkpoint")


def test_a_file_that_is_not_complete(press, good, folder):
    """As a draft is before it gets its head, under the name of a checkpoint."""

    def unfinished(file):
        with file.open("r+b") as raw:
            raw.write(bytes(HEAD))

    file = changed(good, folder, unfinished)
    refused(press, file, "before it was complete", "take the last complete one")


@pytest.mark.parametrize("change", ["format 7", "format 9", "version 0.0", f"format {10**20}"])
def test_another_format_or_version(press, good, folder, change):
    """Known from the first line, whatever the lines behind it may then mean."""
    word = change.split()[0]

    def other(file):
        text = file.read_bytes()
        file.write_bytes(re.sub(rf"{word} [\d.]+".encode(), change.encode(), text, count=1))

    words = "begins with 'dolfinx_mortar checkpoint", change, "with the version that has written it"
    refused(press, changed(good, folder, other), *words)


# -- problems


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"jitter": 0.41}, ["nodes: ", "are not in the checkpoint, such as that at ("]),
        (
            {"law": dm.Elastic(1e5, 0.3)},
            ["solid: materials is 'Elastic', in the checkpoint 'VonMises'"],
        ),
        (
            {"law": dm.VonMises(E=206_900.0, nu=0.29, Y=400.0, a=10_000.0)},
            ["material 0, VonMises: Y is 400.0, in the checkpoint 367.4"],
        ),
        ({"law": {1: STEEL, 2: STEEL}}, ["solid: materials is 'VonMises, VonMises', in the"]),
        (
            {"surface": "facets"},
            ["problem: interfaces is \"Contact(slave=3, master=4, surface='facets')\", in"],
        ),
        ({"slave": 4, "master": 3}, ["problem: interfaces is 'Contact(slave=4"]),
        ({"geometry": "reference"}, ["problem: geometry is 'reference', in", "'updated'"]),
    ],
)
def test_another_problem(good, options, words):
    refused(Press(**options), good, "a checkpoint of another problem", *words)


def with_tool(shape, **options):
    """Return a problem with a tool of a shape, and a rigid side with a point."""
    block = tool_case.Block(n=3)
    point = options.pop("point", [0.0, -10.0])
    base = dm.RigidSide(block.facets, tool_case.BASE, reference=point)
    tool = block.tool(shape, friction=0.3, **options)
    return dm.ContactProblem(dm.Solid(block.u, tool_case.ELASTIC), [base, tool])


def disc(radius, at=8.0):
    """Return a disc that touches the origin from above, as a function, with a point on the axis."""
    return dm.shapes.SignedDistance(
        lambda x: np.hypot(x[0], x[1] - radius) - radius, [0.0, at], length=radius
    )


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("shape", "options", "word"),
    [
        (disc(8.0), {}, ""),
        (disc(9.0, at=8.0), {}, "distances"),
        (disc(8.0, at=9.0), {}, "reference"),
        (disc(8.0), {"point": [5.0, -10.0]}, "reference"),
        (Cylinder([0.0, 8.0], 8.0), {}, ""),
        (Cylinder([0.0, 8.0], 7.0), {}, "distances"),
        (Cylinder([0.0, 8.0], 8.0), {"reference": [0.0, 0.0]}, "reference"),
    ],
)
def test_another_tool(folder, shape, options, word):
    """Its shape and its point belong to the slips, forces and positions of a checkpoint."""
    first = type(shape)([0.0, 8.0], 8.0) if isinstance(shape, Cylinder) else disc(8.0)
    with_tool(first).save(folder / "tool.h5")
    problem = with_tool(shape, **options)
    if word:
        with rejected("a checkpoint of another problem: interfaces[", f"{word} is off by up to "):
            problem.restore(folder / "tool.h5")
    else:
        problem.restore(folder / "tool.h5")


@pytest.mark.mpi
def test_the_same_materials_in_other_cells(folder, monkeypatch):
    """More of one of them; or as many, but others, as if a cell of each had been exchanged."""
    soft = dm.Elastic(1e5, 0.3)
    one, other = Press(law={1: STEEL, 2: soft}), Press(law={2: STEEL, 1: soft})
    one.problem.save(folder / "x.h5")
    assert not differences(*[describe(one.problem.state)] * 2)
    with rejected("Elastic: cells is 40, in the checkpoint 60", "VonMises: cells is 60, in the"):
        other.problem.restore(folder / "x.h5")
    numbers = material_numbers(one.problem.solid)
    counts = COMM.allreduce(np.array([(numbers == k).sum() for k in range(2)]))
    cells = [describe(one.problem.state)[f"material {k}: cells"] for k in KINDS]
    assert counts.tolist() == cells  # one point in each
    first = [np.flatnonzero(numbers == k)[:1] if COMM.rank == 0 else [] for k in range(2)]
    for k, at in enumerate(first):
        numbers[at] = 1 - k
    monkeypatch.setattr(
        "dolfinx_mortar.persistence.checkpoints.material_numbers", lambda solid: numbers
    )
    count = COMM.bcast(sum(map(len, first)))
    with rejected(f"another problem: solid: {count} integration points have another material"):
        one.problem.restore(folder / "x.h5")


@pytest.mark.parametrize(
    ("degree", "options", "word"),
    [
        (2, {}, "displacement: degree is 2, in the checkpoint 1"),
        *(
            pytest.param(1, *case, marks=pytest.mark.slow)
            for case in (
                ({"quadrature_degree": 3}, "solid: quadrature_degree is 3, in the checkpoint 1"),
                ({"kinematics": "plane_stress"}, "solid: kinematics is 'plane stress', in the"),
            )
        ),
    ],
)
def test_another_solid(good, degree, options, word):
    press = Press()
    V = fem.functionspace(press.mesh, ("Lagrange", degree, (2,)))
    solid = dm.Solid(fem.Function(V), STEEL, **options)
    contact = dm.Contact(press.facets, slave=3, master=4)
    with rejected("a checkpoint of another problem", word):
        dm.ContactProblem(solid, [contact]).restore(good)


@pytest.mark.mpi
def test_other_facets_under_the_same_tags(good):
    """The slave side is half as long: the name of the interface is the same."""
    from dolfinx.mesh import compute_midpoints as midpoints
    from dolfinx.mesh import exterior_facet_indices, meshtags

    press = Press()
    facets = exterior_facet_indices(press.mesh.topology)
    x = midpoints(press.mesh, 1, facets)
    old = np.zeros(facets.max(initial=0) + 1, dtype=np.int32)
    old[press.facets.indices] = press.facets.values
    values = np.where((old[facets] == 3) & (x[:, 0] > 0.5), 9, old[facets]).astype(np.int32)
    kept = values > 0
    tags = meshtags(press.mesh, 1, facets[kept], values[kept])
    contact = dm.Contact(tags, slave=3, master=4)
    problem = dm.ContactProblem(press.problem.solid, [contact], bcs=press.problem.bcs)
    with rejected("slave nodes of interfaces[0]: there are", "in the checkpoint 6"):
        problem.restore(good)


@pytest.mark.mpi
def test_results_that_belong_to_another_problem(good, folder):
    """The interface has been taken over: what it shows is not of this problem."""
    press = Press()
    dm.ContactProblem(press.problem.solid, [press.contact], bcs=press.problem.bcs)
    for action, file in ((press.problem.save, folder / "x.h5"), (press.problem.restore, good)):
        with rejected("is also in a problem that was made later", "for each problem"):
            action(file)


# -- arguments


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"checkpoint": 3}, ["checkpoint is 3", "give the name of a file"]),
        ({"checkpoint": ""}, ["checkpoint is ''", "give the name of a file"]),
        ({"checkpoint": "x.h5", "every": 0}, ["every is 0", "an integer >= 1"]),
        ({"checkpoint": "x.h5", "every": 1.5}, ["every is 1.5", "an integer"]),
        ({"checkpoint": "x.h5", "every": True}, ["every is True", "an integer"]),
        ({"every": 2}, ["every is 2", "there is no checkpoint"]),
    ],
)
def test_arguments_of_a_walk(press, given, words):
    with rejected(*words):
        next(press.walk(LEVELS, **given))
    assert not press.problem.u.x.array.any()


def test_names_that_are_none(press):
    for action in (press.problem.save, press.problem.restore):
        with rejected("path is None", "give the name of a file"):
            action(None)


@pytest.mark.mpi
@pytest.mark.skipif(COMM.size == 1, reason="one rank agrees with itself")
def test_ranks_that_do_not_agree(press):
    for given in ({"checkpoint": f"{COMM.rank == LAST}.h5"}, {"every": 1 + (COMM.rank == LAST)}):
        (name,) = given
        with rejected(f"{name} differs between the ranks", "give all ranks the same"):
            next(press.walk(LEVELS, **({"checkpoint": "x.h5"} | given)))
    with rejected("checkpoint differs between the ranks"):
        next(press.walk(LEVELS, checkpoint=None if COMM.rank == LAST else "x.h5"))
    with rejected("path differs between the ranks"):
        press.problem.save(f"{COMM.rank == LAST}.h5")


NO_NAMES = ["a\0b.h5", "no\0folder/x.h5", "\ud800.h5"]


@pytest.mark.mpi
@pytest.mark.parametrize("name", NO_NAMES)
def test_names_that_no_file_can_have(press, name):
    """One of them let rank 0 alone fail, and the others wait for ever."""
    for action in (press.problem.save, press.problem.restore):
        with rejected(f"path is {name!r}", "give the name of a file"):
            action(name)
    with rejected(f"checkpoint is {name!r}", "give the name of a file"):
        next(press.walk(LEVELS, checkpoint=name))
    assert not press.problem.u.x.array.any()


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["x" * 300, "x" * 252, "pipe"])
def test_names_under_which_no_checkpoint_can_be_written(press, folder, name):
    """Too long, or too long for the draft; or in use for what is no file, and would be replaced."""
    if COMM.rank == 0:
        os.mkfifo(folder / "pipe")
    COMM.barrier()
    words = name, "cannot be written", "choose a file in an existing, writable folder"
    with rejected(*words, error=OSError):
        press.problem.save(folder / name)
    if name != "pipe":
        with rejected(*words, error=OSError):
            next(press.walk(LEVELS, checkpoint=folder / name))
    assert [path.name for path in folder.iterdir()] == ["pipe"]
    assert not press.problem.u.x.array.any()


@pytest.mark.mpi
@pytest.mark.parametrize("resume", [True, False])
def test_a_writer_and_a_checkpoint_of_one_name(good, folder, resume):
    """The numbers of run.xdmf are in run.h5: neither replaces the other, whoever comes first."""
    press, file = Press(), folder / "run.h5"
    with dm.Writer(folder / "run.xdmf", press.problem, resume=resume) as out:
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
        dm.Writer(folder / "run.xdmf", press.problem, resume=resume)
    assert file.read_bytes() == good.read_bytes()


@pytest.mark.mpi
@pytest.mark.parametrize("broken", ["json.dumps", "Path.replace"])
def test_what_fails_on_rank_0_alone(press, folder, monkeypatch, broken):
    """Whatever it raises: all ranks are told, and none waits."""

    def fail(*_, **options):
        raise ValueError("as some of Python's functions do")

    monkeypatch.setattr(f"dolfinx_mortar.persistence.tables.{broken}", fail)
    with rejected("x.h5", "as some of Python's functions do", error=OSError):
        press.problem.save(folder / "x.h5")


@pytest.mark.mpi
def test_a_folder_that_is_not_there(press, folder):
    """Told before the first step, not after it."""
    words = "which cannot be written", "existing, writable folder"
    with rejected(*words, error=OSError):
        next(press.walk(LEVELS, checkpoint=folder / "none" / "x.h5"))
    for file in (folder / "none" / "x.h5", folder):
        with rejected(*words, error=OSError):
            press.problem.save(file)
    assert not press.problem.u.x.array.any()


@pytest.mark.mpi
def test_a_folder_that_has_become_read_only(good, monkeypatch):
    """Told before the next step; a walk that is done may still be looked at."""
    names = []

    def refuse(path):
        names.append(path.name)
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(tables.Path, "touch", refuse)
    press = Press()
    with rejected("which cannot be written", "existing, writable folder", error=OSError):
        next(press.walk([*LEVELS, 1.0], checkpoint=good))
    assert not press.problem.history
    assert list(press.walk(LEVELS, checkpoint=good)) == [] and len(press.problem.history) == 1
    assert names == (["good.h5.part"] if COMM.rank == 0 else [])


# -- what goes wrong while writing


@pytest.mark.mpi
@pytest.mark.parametrize("work", ["demand_space", "seal"])
def test_a_disk_that_fails(good, folder, monkeypatch, work):
    """Rank 0 takes what the others send, and all are told; the last checkpoint stays."""
    file, press = changed(good, folder, lambda file: None), Press()

    def fail(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(tables, work, fail)
    with rejected("could not be written", "no space left", error=OSError):
        press.problem.save(file)
    assert file.read_bytes() == good.read_bytes()
    assert [path.name for path in folder.iterdir()] == ["bad.h5"]
    monkeypatch.undo()
    press.problem.save(file)
    press.problem.restore(file)


@pytest.mark.mpi
def test_a_disk_that_takes_nothing_any_more(press, folder, monkeypatch):
    """As file systems that meet an error become read-only: not even the draft can be removed."""

    def fail(*_, **options):
        monkeypatch.setattr(tables.Path, "unlink", fail)
        # whatever it is: on rank 0 alone, it must not keep the others waiting
        raise ValueError("read-only file system")

    monkeypatch.setattr(tables, "seal", fail)
    with rejected("x.h5", "could not be written", "read-only", error=OSError):
        press.problem.save(folder / "x.h5")


@pytest.mark.mpi
def test_a_folder_that_cannot_be_brought_to_the_disk(folder, monkeypatch):
    """Some file systems know that of files only; the checkpoint is there."""
    flush, asked = disk.flush, []

    def fail(path):
        asked.append(path)
        if path.is_dir():
            raise OSError("invalid argument")
        flush(path)

    monkeypatch.setattr(disk, "flush", fail)
    case = Press()
    case.problem.save(folder / "x.h5")
    assert asked == ([folder / "x.h5.part", folder] if COMM.rank == 0 else [])
    case.problem.restore(folder / "x.h5")


@pytest.mark.serial
def test_a_disk_that_is_full(good, folder):
    """Told before HDF5 meets it: that cannot close such a file, and crashes later."""
    file, press = changed(good, folder, lambda file: None), Press()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with rejected("could not be written", "no space for", error=OSError):
            press.problem.save(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert file.read_bytes() == good.read_bytes()
    assert [path.name for path in folder.iterdir()] == ["bad.h5"]
    press.problem.save(file)
    press.problem.restore(file)


@pytest.mark.mpi
def test_without_h5py(press, folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    error = ImportError if COMM.rank == 0 else RuntimeError
    with rejected("checkpoints need h5py", "pip install", error=error):
        next(press.walk(LEVELS, checkpoint=folder / "x.h5"))
