# SPDX-License-Identifier: MIT
"""Checkpoints that somebody has edited, and sealed anew: all is checked before any of it is taken.

Every dataset, and every value of what the file says about itself, is spoiled in every way below.
"""

import copy
import json
import shutil

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.checkpoint.seal import seal
from tests.friction_case import create
from tests.pressed_blocks import rejected

COMM = MPI.COMM_WORLD
LAW = dm.VonMises(E=1000.0, nu=0.3, Y=8.0, a=50.0)
MADE = {}  # problems and their files, by kind


@pytest.fixture(params=["contact", "tie"])
def made(request, tmp_path_factory):
    """Return a problem in some state, the file of another one, and everything of its state."""
    if request.param not in MADE:
        folder = COMM.bcast(tmp_path_factory.mktemp(request.param))
        cases = [create(law=LAW, friction=0.3) for _ in range(2)]
        if request.param == "tie":
            cases = [case.again(dm.Tie) for case in cases]
        for case, way in zip(cases, (0.01, 0.02), strict=True):
            if request.param == "tie":
                case.contact.tightening = np.array([0.0, way / 10])
            table = [(t, case.turn @ np.array([way * t, -way * t])) for t in (0.0, 1.0)]
            list(dm.load_steps(case.problem, [0.5, 1.0], ramp={case.top: table}, progress=False))
        cases[1].problem.save(folder / "good.h5")
        MADE[request.param] = cases[0].problem, folder / "good.h5", state_of(cases[0].problem)
    return MADE[request.param]


def state_of(problem):
    """Return all that a step starts from and all that is shown, bit for bit."""
    committed, fields = problem.committed, [problem.u, *problem.solid.lasting_fields().values()]
    found = [committed.active, committed.displacement, committed.slid, committed.dissipated]
    found += [np.zeros(0) if committed.sliding is None else committed.sliding]
    for interface in problem.interfaces:
        kept = interface.resultants
        fields += interface.functions
        found += [kept.force, kept.moment, kept.master_force, kept.master_moment]
        found += [kept.multiplier, kept.nodes, kept.carries]
        found += [getattr(interface, name, 0.0) for name in ("tightening", "dissipated")]
    found = [np.asarray(array).tobytes() for array in [*(f.x.array for f in fields), *found]]
    steps = [step.as_dict() for step in committed.history], committed.walk
    flags = committed.begun, committed.level, committed.walked
    return found, repr(steps), *flags, problem.system.faced


def edited(good, edit):
    """Return a copy of a file that rank 0 has edited."""
    file = good.with_name("edited.h5")
    COMM.barrier()
    if COMM.rank == 0:
        shutil.copy(good, file)
        with h5py.File(file, "r+") as opened:
            edit(opened)
        seal(file)
    COMM.barrier()
    return file


def replaced(name, content):
    """Return the edit that puts another dataset, or nothing, in the place of one."""

    def edit(opened):
        del opened[name]
        if content is not None:
            opened[name] = content

    return edit


def edits_of(name, array):
    """Yield how a dataset is spoiled, and the edit."""
    yield "missing", replaced(name, None)
    yield "a group", lambda opened: (replaced(name, None)(opened), opened.create_group(name))
    yield "texts", replaced(name, np.full(array.shape, b"text"))
    yield "integers", replaced(name, np.nan_to_num(array, posinf=0.0, neginf=0.0).astype(int))
    yield "single precision", replaced(name, array.astype(np.float32))
    yield "flat", replaced(name, array.ravel())
    yield "a number", replaced(name, 1.0)
    yield "nothing", replaced(name, array[:0])
    yield "a row less", replaced(name, array[1:])
    yield "a column more", replaced(name, np.hstack([array, array[:, :1]]))
    for number in (np.nan, np.inf, -np.inf):
        spoiled = array.copy()
        spoiled[len(array) // 2, 0] = number
        yield str(number), replaced(name, spoiled)
    if name.endswith(("/active", "/carries")) and "values" in name:
        yield "a half", replaced(name, np.full(array.shape, 0.5))


def allowed(name, how):
    """Tell whether an edit makes another whole checkpoint: there may be no such column, no gap."""
    optional = name.endswith(("/sliding", "/supports", "/near", "/paired")) or "/shown/" in name
    return (how == "missing" and optional) or (how == "nan" and name.endswith("/gap"))


def arrays_of(file):
    """Return all arrays of floats by name, on all ranks."""
    found = {}
    if COMM.rank == 0:
        with h5py.File(file) as opened:
            opened["tables"].visititems(
                lambda name, item: (
                    found.update({f"tables/{name}": item[:]}) if hasattr(item, "shape") else None
                )
            )
    return COMM.bcast(found)


@pytest.mark.mpi
def test_no_array_that_is_none_of_ours(made):
    """Of all arrays and spoilings every fifth, on several ranks fewer; all have passed."""
    problem, good, before = made
    edits = [
        (name, how, edit)
        for name, array in arrays_of(good).items()
        for how, edit in edits_of(name, array)
        if not allowed(name, how)
    ]
    assert len(edits) > 150
    for name, how, edit in edits[:: 5 if COMM.size == 1 else 29]:
        file = edited(good, edit)
        with rejected(f"path is {str(file)!r}, ", name.split("/")[1]):
            problem.restore(file)
            raise AssertionError(f"{name}, {how}, was taken")
        assert state_of(problem) == before, (name, how)


def values_of(value, path=()):
    """Yield the way to every value of what JSON holds."""
    yield path
    entries = value.items() if isinstance(value, dict) else ()
    for key, entry in enumerate(value) if isinstance(value, list) else entries:
        yield from values_of(entry, (*path, key))


DELETED = object()
OTHERS = (DELETED, None, "text", [], {}, float("nan"), float("inf"), -1, 0.5, True, [[1.0]])


def with_value(about, path, value):
    """Return a copy with another value, or none."""
    about = copy.deepcopy(about)
    holder = about
    for key in path[:-1]:
        holder = holder[key]
    if value is DELETED:
        del holder[path[-1]]
    else:
        holder[path[-1]] = value
    return about


WITH_NUMBERS = ("level", "walk", "steps", "interfaces", "tightening")


def whole(about, path, value, old):
    """Tell whether it may be what `save` has written: numbers of the same kind, no results."""
    if path[0] == "steps" and len(path) > 3:  # a report of what was: shown, and not gone on from
        return True
    if isinstance(old, float) and path[0] in WITH_NUMBERS:
        return isinstance(value, int | float) and np.isfinite(value) and value is not True
    if path[0] == "walk" and len(path) < 4:  # no walk, no tables, or one less
        return value is None or value == [] or (value is DELETED and len(path) == 3)
    if path == ("begun",):
        return value is True
    if path[0] == "interfaces" and len(path) == 2:
        return value is None
    if path[0] == "steps" and path[2:] == ("forces",):
        return value == [] or value == [[1.0]]
    if path[0] == "steps" and path[2:] == ("reactions",):
        return value == []
    if "center" in path and isinstance(value, float):
        return isinstance(old, float) and abs(value - old) < 1e-12
    return value == old


@pytest.mark.mpi
def test_nothing_that_the_file_says_is_believed(made):
    """Of all values and spoilings every seventh, on several ranks fewer; all have passed."""
    problem, good, before = made
    about = None
    if COMM.rank == 0:
        with h5py.File(good) as opened:
            about = json.loads(opened["about"][:].tobytes())
    about = COMM.bcast(about)
    refused = 0
    cases = [(path, value) for path in values_of(about) if path for value in OTHERS]
    for path, value in cases[:: 7 if COMM.size == 1 else 61]:
        old = about
        for key in path:
            old = old[key]
        text = json.dumps(with_value(about, path, value)).encode()
        file = edited(good, replaced("about", np.frombuffer(text, dtype=np.uint8)))
        if whole(about, path, value, old):
            continue
        with rejected(f"path is {str(file)!r}, "):
            problem.restore(file)
            raise AssertionError(f"{path} = {value} was taken")
        assert state_of(problem) == before, (path, value)
        refused += 1
    assert refused > 5


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("level",), float("nan"), "level is nan: need a finite number"),
        (("walked",), -1, "walked is -1, but there are 2 steps"),
        (("walked",), 3, "walked is 3, but there are 2 steps"),
        (("walk", "start"), float("inf"), "walk['start'] is inf: need a finite number"),
        (("walk", "ramp", 0), [[0.0, 1.0, 2.0]], "need two rows or more, of equal length"),
        (("walk", "ramp", 0, 1), [1.0, 2.0], "need two rows or more, of equal length"),
        (("walk", "ramp", 0, 1, 0), -1.0, "need finite numbers, and levels that rise"),
        (("walk", "ramp", 0, 1, 1), float("nan"), "need finite numbers, and levels that rise"),
        (("begun",), 1, "about['begun'] is 1: need bool"),
        (("steps",), {}, "about['steps'] is {}: need a list"),
        (("steps", 1, "time"), float("inf"), "steps[1].time is inf: need a finite number"),
        (("steps", 0, "number"), -1, "steps[0] has number -1"),
        (("steps", 0, "parts"), [], "steps[0] has number 1, 0 parts"),
        (("steps", 0, "parts", 0, "rtol"), "x", "['parts'][0]['rtol'] is 'x': need float"),
        (("interfaces",), [], "interfaces has 0 entries, but there are 1 interfaces"),
        (("interfaces", 0, "force"), [1.0], "interfaces[0].force is [1.0]: need 2 finite"),
        (("problem", "mesh"), DELETED, "about['problem']['mesh'] is missing"),
        (("problem", "materials", 0, "center"), [], "materials[0].center is []: need 2 finite"),
    ],
)
def test_what_is_wrong_is_named(made, path, value, words):
    problem, good, before = made
    with h5py.File(good) as opened:
        about = json.loads(opened["about"][:].tobytes())
    text = json.dumps(with_value(about, path, value)).encode()
    file = edited(good, replaced("about", np.frombuffer(text, dtype=np.uint8)))
    with rejected(f"path is {str(file)!r}, which cannot be taken over: ", words):
        problem.restore(file)
    assert state_of(problem) == before


@pytest.mark.parametrize(
    ("name", "how", "words"),
    [
        ("tables/nodes/values/displacement", "nan", "holds NaN or infinity"),
        ("tables/points/values/stress", "inf", "holds NaN or infinity"),
        ("tables/interface 0/values/multiplier", "nan", "holds NaN or infinity"),
        ("tables/interface 0/values/carries", "a half", "holds other numbers than 0 and 1"),
        ("tables/interface 0/values/gap", "missing", "is missing"),
        ("tables/nodes/values/active", "a group", "is a group: need float64 of 2 dimensions"),
        ("tables/nodes/values/active", "texts", "is |S4 of shape"),
        ("tables/points/values/stress", "a row less", "rows, not"),
        ("tables/nodes/values/displacement", "a column more", "has 3 components: need 2"),
        ("tables/nodes/pieces", "nan", "are not those of"),
        ("tables/nodes/places", "missing", "is missing"),
    ],
)
def test_which_array_is_wrong_is_named(made, name, how, words):
    problem, good, before = made
    edit = dict(edits_of(name, arrays_of(good)[name]))[how]
    if name.endswith("pieces"):
        edit = replaced(name, np.full_like(arrays_of(good)[name], np.nan))
    file = edited(good, edit)
    with rejected(f"path is {str(file)!r}, which cannot be taken over: {name}", words):
        problem.restore(file)
    assert state_of(problem) == before
