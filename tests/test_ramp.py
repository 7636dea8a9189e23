# SPDX-License-Identifier: MIT
"""Ramps: tables of Constants over load levels, as good as a function, and data besides."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.common.agreement import find_constants
from dolfinx_mortar.steps.ramp import check_range, difference, read_ramps
from tests.cases.pressed_blocks import Bare, PressedBlocks, rejected
from tests.checkpoint_program import LEVELS, Press
from tests.checkpoint_runs import agree

COMM = MPI.COMM_WORLD
ROWS = [(0.0, (0.0, 0.0)), (0.6, (0.001, -0.005)), (1.0, (0.002, -0.008))]


def by_function(constant, rows):
    """Return the function of the level that a table stands for."""
    levels, values = zip(*rows, strict=True)

    def on_time(t):
        columns = np.array(values).T
        constant.value[:] = [np.interp(t, levels, column) for column in columns]

    return on_time


def constant(value):
    """Return a Constant on any mesh."""
    return fem.Constant(PressedBlocks().mesh, np.array(value))


# -- the same as a function ------------------------------------------------------------------------


@pytest.mark.mpi
def test_a_table_is_as_good_as_a_function():
    """To the last bit, with a kink, with friction, up and down."""
    one, other = (Press(friction=0.3) for _ in range(2))
    list(one.walk(LEVELS, on_time=None, ramp={one.top: ROWS}))
    list(other.walk(LEVELS, on_time=by_function(other.top, ROWS)))
    agree(one.numbers(), other.numbers())
    if COMM.size == 1:  # ranks add up in the order in which messages come
        assert one.numbers() == other.numbers()
        assert np.array_equal(one.problem.u.x.array, other.problem.u.x.array)


@pytest.mark.mpi
def test_a_table_that_nothing_reads_is_told_of():
    """Of a support that was given a copy, once; not where a function may read what it likes."""
    case = PressedBlocks()
    load, spring, friction, warm = (fem.Constant(case.mesh, 0.0) for _ in range(4))
    copied, modulus = fem.Constant(case.mesh, np.zeros(2)), fem.Constant(case.mesh, 1e3)
    v = ufl.TestFunction(case.V)
    solid = dm.Solid(case.u, dm.Elastic(modulus, 0.3), eigenstrain=2 * warm)
    contact = dm.Contact(case.facets, slave=3, master=4, friction=friction)
    terms = [dm.WeakForm(solid, energy=spring * ufl.inner(case.u, case.u) * ufl.dx)]
    own = {"bcs": case.bcs(), "loads": load * v[0] * ufl.dx, "terms": terms}
    problem = dm.ContactProblem(solid, [contact], **own)
    read = load, spring, friction, warm, modulus, case.top
    ramp = {one: [(0, one.value), (2, one.value)] for one in read}
    ramp[copied] = [(0, (0, 0)), (2, (0, -1))]

    def told(**options):
        steps = dm.load_steps(problem, [1, 2], start=0, ramp=ramp, progress=False, **options)
        words = "is for a Constant that nothing"
        return [[n for n in step.report.notes if words in n] for step in steps]

    first, second = told()
    assert len(first) == 1 and first[0].startswith("ramp: table 7 ") and not second
    assert told(on_time=lambda t: None) == [[], []]
    own = dm.ContactProblem(solid, [contact], bcs=case.bcs(), terms=[Bare()])
    assert find_constants(own.inputs) is None


def test_a_function_finds_the_values_of_the_tables():
    """Both may be given: the function is called last, for every level as often as there are."""
    press, seen = Press(), []
    kept = fem.Constant(press.mesh, 0.0)

    def on_time(t):
        seen.append((t, *press.top.value, float(kept.value)))

    ramp = {press.top: ROWS, kept: [(0.0, 1.0), (1.0, 3.0)]}
    list(press.walk([0.3, 0.6], on_time=on_time, ramp=ramp))
    assert seen == [(0.3, 0.0005, -0.0025, 1.6), (0.6, 0.001, -0.005, 2.2)]


def test_values_of_any_shape_and_tables_that_are_read_once():
    tensor, number = constant(np.zeros((2, 2))), constant(0.0)
    table = [(0.0, np.zeros((2, 2))), (2.0, np.array([[1.0, 2.0], [3.0, 4.0]]))]
    pairs = np.column_stack([[0.0, 1.0, 2.0], [0.0, 5.0, 4.0]])
    for ramp in ({tensor: iter(table), number: pairs}, {tensor: table, number: iter(pairs)}):
        for one in read_ramps(COMM, ramp):
            one.set(1.5)
        assert tensor.value.tolist() == [[0.75, 1.5], [2.25, 3.0]] and number.value == 4.5


# -- bad input -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (None, "ramp: table 1 is None: give rows (level, value), at least two, with values of"),
        ([(0.0, (0.0, 0.0)), (1.0, 2.0)], "row 2 is (1.0, 2.0): give rows"),
        ([(0.0, (0.0, 0.0)), (1.0, (1.0, np.nan))], "in finite numbers"),
        ([(0.0, (0.0, 0.0)), (0.0, (1.0, 1.0))], "levels [0.0, 0.0]: they must rise from row"),
    ],
)
def test_tables_that_are_none(table, words):
    with rejected("ramp: table 1", words):
        read_ramps(COMM, {constant((0.0, 0.0)): table})


def test_keys_that_are_none():
    press = Press()
    rows = [(0.0, 0.0), (1.0, 1.0)]
    for ramp, words in (
        ([(press.top, ROWS)], "give a dictionary {Constant: [(level, value), ...]}"),
        ({"top": rows}, "ramp: table 1: the key is 'top': give a dolfinx Constant"),
        ({press.top: ROWS, press.problem.u: rows}, "ramp: table 2: the key is"),
    ):
        with rejected(words):
            next(press.walk(LEVELS, on_time=None, ramp=ramp))
    assert not press.problem.history


def test_levels_that_a_table_does_not_hold():
    """Before the first step, those at which a cut would ask, too."""
    press = Press()
    for rows, levels, start, words in (
        (ROWS, [0.5, 1.1], None, "table 1 holds levels from 0 to 1, but the run goes from 0"),
        (ROWS, [0.5], -0.1, "the run goes from -0.1 over levels between -0.1 and 0.5: add rows"),
    ):
        with rejected("ramp: ", words):
            next(press.walk(levels, on_time=None, ramp={press.top: rows}, start=start))
    assert not press.problem.history
    check_range(read_ramps(COMM, {press.top: ROWS}), [0.0, 1.0 + 1e-15])  # by round-off: none


# -- restart ---------------------------------------------------------------------------------------


@pytest.mark.mpi
def test_a_walk_goes_on_with_its_tables(folder):
    """After three of four levels, in another numbering; the tables may end elsewhere."""
    file = folder / "run.h5"
    whole, first, second, third = Press(), Press(), Press(partition="stripes"), Press()
    list(whole.walk(LEVELS, on_time=None, ramp={whole.top: ROWS}))
    list(first.walk(LEVELS[:3], on_time=None, ramp={first.top: ROWS}, checkpoint=file))
    farther = [*ROWS, (2.0, (0.5, -0.5))]
    left = list(second.walk(LEVELS, on_time=None, ramp={second.top: farther}, checkpoint=file))
    assert [step.number for step in left] == [4]
    agree(second.numbers(), whole.numbers())
    assert not list(third.walk(LEVELS, on_time=None, ramp={third.top: farther}, checkpoint=file))
    assert np.allclose(third.top.value, [0.00137500, -0.006125])  # of level 0.75


def test_tables_are_compared_where_the_walk_has_been():
    """At the corners of both, by more than round-off."""
    number, rows = constant(0.0), [(0.0, 0.0), (0.5, 1.0), (1.0, 0.0)]
    saved = [read_ramps(COMM, {number: rows})[0].rows]
    other = [[(t, v * (1 + error)) for t, v in rows] for error in (1e-14, 1e-10)]
    for table, differs in zip([*other, rows[::2]], (False, True, True), strict=True):
        found = difference(saved, read_ramps(COMM, {number: table}), [0.0, 1.0])
        assert bool(found) == differs
    vector = read_ramps(COMM, {constant((0.0, 0.0)): ROWS})
    assert "another shape" in difference(saved, vector, [0.0, 1.0])


@pytest.mark.mpi
def test_a_walk_does_not_go_on_with_other_tables(folder):
    file = folder / "run.h5"
    first = Press()
    list(first.walk(LEVELS[:2], on_time=None, ramp={first.top: ROWS}, checkpoint=file))
    other = [ROWS[0], (0.4, (0.001, -0.005)), ROWS[2]]
    press, said = Press(), "table 1 gives [0.001, -0.005] at level 0.4 now, [0.000666"
    with rejected("ramp: ", said, f"the checkpoint {str(file)!r} was written: give the tables"):
        next(press.walk(LEVELS, on_time=None, ramp={press.top: other}, checkpoint=file))
    assert not press.problem.history and not press.problem.u.x.array.any()
    with rejected("ramp: there are 0 tables now, 1 then"):
        next(press.walk(LEVELS, checkpoint=file))
