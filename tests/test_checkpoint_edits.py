# SPDX-License-Identifier: MIT
"""Edited checkpoints with a valid checksum: all contents are checked before any is restored."""

import copy
import json
import shutil

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.checkpoint.seal import seal
from tests.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.pressed_blocks import PressedBlocks, rejected

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
LAW = dm.VonMises(E=1000.0, nu=0.3, Y=8.0, a=50.0)
SIDES = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}
SOME = slice(None, None, 1 if COMM.size == 1 else 4)  # a message between ranks takes its time
MADE = {}  # a problem in some state, the file of another state, and all of the first, by kind


class Memory(dm.Term):
    """No force, but a state."""

    def __init__(self, V, value):
        """Keep a scalar everywhere."""
        self.kept = fem.Function(V.sub(0).collapse()[0])
        self.kept.x.array[:] = value

    @property
    def state(self):
        return {"kept": self.kept}

    def add_forces(self, F):
        pass

    def add_tangent(self, K):
        pass


def walked(kind, way):
    """Return a problem with a history, slips or a tightening, plastic strain and a term's state."""
    case = PressedBlocks(jitter=0.2)
    side = dm.Contact(case.facets, **SIDES, friction=0.3)
    if kind == "tie":
        side = dm.Tie(case.facets, **SIDES)
        side.tightening = np.array([0.0, way / 10])
    problem = case.problem([side], law=LAW, terms=[Memory(case.V, way)])
    table = [(t, (way * t, -way * t)) for t in (0.0, 1.0)]
    list(dm.load_steps(problem, [0.5, 1.0], ramp={case.top: table}, progress=False))
    return problem


@pytest.fixture(params=["contact", "tie"])
def made(request, tmp_path_factory):
    kind = request.param
    if kind not in MADE:
        good = COMM.bcast(tmp_path_factory.mktemp(kind)) / "good.h5"
        problem = walked(kind, 0.01)
        walked(kind, 0.02).save(good)
        MADE[kind] = problem, good, state_of(problem)
    return MADE[kind]


def state_of(problem):
    """Return all that a step starts from and all that is shown, bit for bit."""
    committed, fields = problem.committed, [problem.u, *problem.solid.lasting_fields().values()]
    fields += problem.state.states_of_terms.values()
    arrays = [committed.active, committed.displacement, committed.slid, committed.dissipated]
    arrays += [committed.paired.at, *committed.paired.near, committed.supports.forces]
    arrays += [np.zeros(0) if committed.sliding is None else committed.sliding]
    for interface in problem.interfaces:
        fields += interface.functions
        arrays += [*vars(interface.resultants).values()]
        arrays += [getattr(interface, name, 0.0) for name in ("tightening", "dissipated")]
    bits = [np.asarray(array).tobytes() for array in [*(f.x.array for f in fields), *arrays]]
    steps = [(step.number, step.time, step.forces) for step in committed.history], committed.walk
    return (
        bits,
        repr(steps),
        committed.begun,
        committed.level,
        committed.walked,
        problem.system.faced,
    )


def refused(made, edit, *words):
    """Expect that a file which rank 0 has edited changes no bit."""
    problem, good, before = made
    file = good.with_name("edited.h5")
    COMM.barrier()
    if COMM.rank == 0:
        shutil.copy(good, file)
        with h5py.File(file, "r+") as opened:
            edit(opened)
        seal(file)
    COMM.barrier()
    with rejected(f"path is {str(file)!r}, which cannot be restored: ", *words, "; take a file"):
        problem.restore(file)
    assert state_of(problem) == before


def test_a_whole_file_is_taken(made):
    """What the other tests compare does change; and then it is put back for them."""
    problem, good, before = made
    own = good.with_name("own.h5")
    problem.save(own)
    problem.restore(good)
    changed = [one != other for one, other in zip(state_of(problem)[0], before[0], strict=True)]
    assert COMM.allreduce(sum(changed)) > 10
    problem.restore(own)
    assert state_of(problem) == before


# -- arrays --------------------------------------------------------------------------------------

TERM = "nodes/values/term 0 kept"
TWICE = lambda a: np.hstack([a, a])  # noqa: E731


def spoilt(value):
    """Return the edit that sets one number."""

    def edit(array):
        array = array.copy()
        array[len(array) // 2, 0] = value
        return array

    return edit


@pytest.mark.parametrize(
    ("name", "edit", "words"),
    [
        (TERM, TWICE, "has 2 components: need 1"),
        (TERM, lambda a: None, "is missing"),
        (TERM, spoilt(-np.inf), "holds NaN or infinity"),
        ("nodes/values/displacement", spoilt(np.nan), "holds NaN or infinity"),
        ("nodes/values/displacement", TWICE, "has 4 components: need 2"),
        ("nodes/values/displacement", lambda a: a[:, :1], "has 1 components: need 2"),
        ("nodes/values/displacement", lambda a: a[1:], "rows: need"),
        ("nodes/values/displacement", lambda a: a.astype("f4"), "is float32 of shape"),
        ("nodes/values/displacement", lambda a: a.astype(int), "is int64 of shape"),
        ("nodes/values/displacement", np.ravel, "need float64 of 2 dimensions"),
        ("nodes/values/active", spoilt(0.5), "other numbers than 0 and 1"),
        ("nodes/values/supports", TWICE, "has 8 components: need 4"),
        ("nodes/values/paired", spoilt(np.inf), "holds NaN or infinity"),
        ("nodes/pieces", lambda a: np.full_like(a, np.nan), "are not those of"),
        ("nodes/pieces", lambda a: a[:, :3], "are not those of"),
        ("nodes/places", lambda a: None, "places"),
        ("points/values/stress", spoilt(np.inf), "holds NaN or infinity"),
        ("points/values/committed/plastic_strain", TWICE, "components: need"),
        ("points/values/material", TWICE, "has 2 components: need 1"),
        ("interface 0/values/multiplier", TWICE, "components: need"),
        ("interface 0/values/multiplier", spoilt(np.nan), "holds NaN or infinity"),
        ("interface 0/values/carries", spoilt(2.0), "other numbers than 0 and 1"),
        ("interface 0/values/near", spoilt(-1.0), "other numbers than 0 and 1"),
        ("interface 0/values/gap", lambda a: None, "is missing"),
        ("interface 0/values/gap", spoilt(np.inf), "holds NaN or infinity"),
    ][SOME],
)
def test_no_array_that_the_problem_cannot_have(made, name, edit, words):
    def replace(opened):
        array = opened[f"tables/{name}"][:]
        del opened[f"tables/{name}"]
        if (other := edit(array)) is not None:
            opened[f"tables/{name}"] = other

    refused(made, replace, name.split("/")[-1], words)


@pytest.mark.parametrize("made", ["contact"], indirect=True)
def test_the_slips_of_a_contact(made):
    def remove(opened):
        del opened["tables/interface 0/values/slid"]

    refused(made, remove, "tables/interface 0/values/slid is missing")


# -- what is no array ----------------------------------------------------------------------------

NAN, DELETED = float("nan"), object()
NONE = dict.fromkeys(("stored", "dissipated", "friction", "damping", "supports", "contact"), 0.0)
LEDGER = NONE | {"initial": 1.0, "kinetic": 3.0, "loads": 2.0, "largest": 3.0, "defect": 0.0}
ENERGIES = "steps", 1, "parts", 0, "ledger"


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("level",), NAN, "level is nan: need a finite number"),
        (("level",), "1", "level is '1': need a finite number"),
        (("level",), DELETED, "KeyError: 'level'"),
        (("begun",), 1, "begun is 1: need true or false"),
        (("walked",), 3, "walked is 3, but there are 2 steps"),
        (("walked",), True, "walked is True, but there are 2 steps"),
        (("walk", "start"), None, "walk.start is None: need a finite number"),
        (("walk", "ramp"), DELETED, "walk has start, settings: need start and ramp"),
        (("walk", "settings"), [1.0], "walk.settings is [1.0]: need values by name"),
        (("walk", "ramp", 0), [[0.0, 1.0, 2.0]], "need two rows or more, of equal length"),
        (("walk", "ramp", 0, 1, 0), -1.0, "need finite numbers, and rising levels"),
        (("walk", "ramp", 0, 1, 1), NAN, "need finite numbers, and rising levels"),
        (("steps", 1, "time"), float("inf"), "steps[1].time is inf: need a finite number"),
        (("steps", 0, "number"), 0, "steps[0] has number 0 and 1 parts"),
        (("steps", 0, "parts"), [], "steps[0] has number 1 and 0 parts"),
        (("steps", 0, "parts", 0, "certificate"), {"gap": 0.0}, "TypeError"),
        (ENERGIES, LEDGER | {"stored": NAN}, "steps[1].parts[0].ledger.stored is nan: need a"),
        (
            ENERGIES,
            LEDGER | {"loads": 0.0},
            "ledger does not add up: its energies and works are of",
        ),
        (ENERGIES, LEDGER | {"impulses": [[1.0]]}, "ledger.impulses[0] is [1.0]: need 2 finite"),
        (ENERGIES, LEDGER | {"impulses": [None] * 2}, "ledger has 2 impulses: need 1"),
        (ENERGIES, {"kinetic": 1.0}, "TypeError"),
        (("steps", 0, "forces"), [], "steps[0] has 0 forces: need 1"),
        (("steps", 0, "forces", 0), [1.0], "steps[0].forces[0] is [1.0]: need 2 finite numbers"),
        (("interfaces",), [], "interfaces has 0 entries, but there are 1 interfaces"),
        (("interfaces", 0, "force"), [1.0, NAN], "interfaces[0].force is [1.0, nan]: need 2"),
        (("interfaces", 0, "moment"), [1.0], "interfaces[0].moment is [1.0]: need 3"),
        (("found",), [None], "AttributeError"),
        (("found", 0), {"worn": [0.1]}, "found[0] has worn, but"),
        (("problem", "mesh"), DELETED, "problem lacks mesh"),
        (("problem",), [], "AttributeError"),
    ][SOME],
)
def test_nothing_that_no_problem_can_have(made, path, value, words):
    def replace(opened):
        about = holder = json.loads(opened["about"][:].tobytes())
        for key in path[:-1]:
            holder = holder[key]
        if value is DELETED:
            del holder[path[-1]]
        else:
            holder[path[-1]] = copy.deepcopy(value)
        del opened["about"]
        opened["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)

    refused(made, replace, words)


@pytest.mark.parametrize("made", ["tie"], indirect=True)
def test_the_tightening_of_a_tie(made):
    """Its numbers; and a kind of one's own that refuses them changes nothing either."""
    problem, good, before = made
    for value, words in (([0.1], "need 2 finite"), ([0.1, NAN], "need 2 finite")):
        test_nothing_that_no_problem_can_have(made, ("found", 0, "tightening"), value, words)
    tie = problem.interfaces[0]

    def refuse(found):
        tie.tightening = np.array([1.0, 1.0])
        if COMM.rank == COMM.size - 1:
            raise ValueError("not as tight as this")

    tie.take_found = refuse
    with rejected("not as tight as this"):
        problem.restore(good)
    del tie.take_found
    assert state_of(problem) == before


def test_what_no_restart_could_read_is_not_saved(tmp_path):
    """Of a term of one's own, which nobody else has looked at."""
    problem, file = walked("tie", 0.01), COMM.bcast(tmp_path / "x.h5")
    kept = problem.state.states_of_terms["term 0 kept"]
    if COMM.rank == COMM.size - 1:
        kept.x.array[:] = np.inf
    with rejected("term 0 kept holds NaN or infinity"):
        problem.save(file)
    assert not file.exists()
