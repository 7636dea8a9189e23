# SPDX-License-Identifier: MIT
"""Arguments of steps: admissible values, and equality on all ranks."""

from types import SimpleNamespace

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.problem import checks
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.cases.pressed_blocks import COMM, ELASTIC, PressedBlocks, rejected

STEPS = {"times": [0.5, 1.0], "start": None, "max_cuts": 6, "cuts": "halve"}
LAST = COMM.size - 1


def unequal(name):
    """Expect the error about an argument that the last rank gives differently; none on one rank."""
    return rejected(
        f"{name} differs between the ranks", f"on rank {LAST}", "give all ranks the same"
    )


# -- what they may be


@pytest.mark.parametrize("problem", [None, "x", dm.Solid, 3])
def test_what_is_no_problem(problem):
    with rejected("problem is", "give a ContactProblem(solid"):
        checks.check_problem(problem, dm.ContactProblem)


@pytest.mark.parametrize("problem", [None, "x"])
def test_steps_of_no_problem(problem):
    with rejected("problem is", "give a ContactProblem(solid"):
        dm.newton(problem)
    with rejected("problem is", "give a ContactProblem(solid"):
        next(dm.load_steps(problem, [1.0]))


@pytest.mark.parametrize(
    "bad",
    [
        {"on_time": 5},
        {"progress": np.zeros((2, 2))},
        {"times": b"x"},
        {"times": [True]},
        {"start": np.nan},
        {"max_cuts": -1},
        {"cuts": "half"},
    ],
)
def test_load_steps_check_their_arguments(bad):
    case = PressedBlocks()
    with rejected(next(iter(bad))):
        next(dm.load_steps(case.problem(), **({"times": [1.0]} | bad)))
    assert not case.u.x.array.any()


SOME = (None, True, 5, np.nan, 10**400, "x", b"x", [], {}, (), np.zeros((2, 2)), 1j, object)
SIDES = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}


def kinds(*types):
    """Return what tells whether a value is of one of the types."""
    return lambda value: isinstance(value, types)


def is_tag(value):
    return value is SOME[2]


def or_none(value):
    return value is None or callable(value)


def mortar(good, **given):
    dm.assemble_mortar(**({"V": good.case.V, "facet_tags": good.case.facets} | SIDES | given))


def points(good, **given):
    dm.segments(**({"V": good.case.V, "facet_tags": good.case.facets} | SIDES | given))


# What is said, a call, and what it takes.
CALLS = [
    ("petsc_options_prefix", lambda g, x: g.case.problem(petsc_options_prefix=x), kinds(str)),
    ("geometry", lambda g, x: g.case.problem(geometry=x), kinds()),
    ("name", lambda g, x: g.problem.solid.max(x), kinds(str)),
    ("name", lambda g, x: g.problem.solid.cell_values(x), kinds(str)),
    ("value", lambda g, x: g.tags.find(x), lambda x: is_tag(x) or isinstance(x, str)),
    ("name", lambda g, x: g.tags.tag(x), lambda x: is_tag(x) or isinstance(x, str)),
    ("names: 'a'", lambda g, x: dm.Tags(g.tags, {"a": x}), is_tag),
    ("step", lambda g, x: dm.summarise(x), kinds()),
    ("path", lambda g, x: dm.write_summary(x, g.problem, []), kinds(str, bytes)),
    ("problem", lambda g, x: dm.write_summary("x.json", x, []), kinds()),
    ("steps", lambda g, x: dm.write_summary("x.json", g.problem, x), kinds(list, tuple)),
    ("steps: a row is", lambda g, x: dm.write_summary("x.json", g.problem, [x]), kinds(dict)),
    ("V", lambda g, x: mortar(g, V=x), kinds()),
    ("facet_tags", lambda g, x: mortar(g, facet_tags=x), kinds()),
    ("u has to be", lambda g, x: mortar(g, u=x), or_none),
    ("weight", lambda g, x: mortar(g, weight=x), or_none),
    ("V", lambda g, x: points(g, V=x), kinds()),
    ("facet_tags", lambda g, x: points(g, facet_tags=x), kinds()),
    ("slave", lambda g, x: points(g, slave=x), is_tag),
    ("u has to be", lambda g, x: points(g, u=x), or_none),
    ("qp", lambda g, x: dm.newton(g.problem, qp=x), kinds()),
    ("qp", lambda g, x: dm.qp.solve(x), kinds()),
    ("comm", lambda g, x: dm.qp.LinearSolver(x, prefix="x_"), kinds()),
    ("cell_tags", lambda g, x: dm.Solid(g.case.u, {1: ELASTIC}, x), kinds(type(None))),
    ("path", lambda g, x: g.problem.save("no\0such" if x is None else x), kinds(str, bytes)),
    ("u", lambda g, x: g.contact.gather(x), kinds()),
    ("on_time", lambda g, x: next(dm.load_steps(g.problem, [1.0], on_time=x)), or_none),
]


@pytest.mark.parametrize(("said", "call", "takes"), CALLS)
def test_what_makes_no_sense_anywhere(said, call, takes):
    """The error names the argument; none is that of a library below."""
    case = PressedBlocks()
    tags = dm.Tags(case.facets, {"top": TOP_OF_LOWER})
    good = SimpleNamespace(case=case, problem=case.problem(), tags=tags)
    (good.contact,) = good.problem.contacts
    good.contact.resultants = object()  # as if there were some
    for bad in SOME:
        if not takes(bad):
            with rejected(f"{said} " if " " not in said else said):
                call(good, bad)
    assert not case.u.x.array.any()


@pytest.mark.parametrize("tag", [2**31, -(2**31) - 1, pytest.param(10**400, id="huge")])
def test_tags_beyond_32_bits(tag):
    case = PressedBlocks()
    tags = dm.Tags(case.facets, {"top": TOP_OF_LOWER})
    for call in (tags.find, tags.tag, lambda tag: dm.Tags(tags, {"a": tag})):
        with rejected("32 bits"):
            call(tag)


def test_a_problem_is_one():
    checks.check_problem(PressedBlocks().problem(), dm.ContactProblem)


@pytest.mark.parametrize(
    ("given", "levels"),
    [
        ({}, [0.5, 1.0]),
        ({"times": np.array([1, 0.5])}, [1.0, 0.5]),
        ({"times": (t for t in (1, 2))}, [1.0, 2.0]),
        ({"times": range(3)}, [0.0, 1.0, 2.0]),
        ({"times": []}, []),
        ({"start": 0, "max_cuts": 0, "cuts": "none"}, [0.5, 1.0]),
        ({"start": np.float32(0.5), "max_cuts": np.int32(3)}, [0.5, 1.0]),
    ],
)
def test_load_steps_that_make_sense(given, levels):
    found = checks.check_load_steps(**(STEPS | given))
    assert found == levels and all(type(level) is float for level in found)


@pytest.mark.parametrize(
    ("name", "bad", "remedy"),
    [
        *(("times", t, "give a list") for t in (None, 1.0, "1.0", np.array(1.0))),
        *(("times", [0.5, t], "finite") for t in (np.nan, np.inf, None, "1", True, 1j, [1.0])),
        *(("start", t, "or None") for t in (np.nan, -np.inf, "0", False, [0.0])),
        *(("max_cuts", t, "an integer >= 0") for t in (-1, 1.5, None, "6", True)),
        *(("cuts", t, "'halve' or 'none'") for t in ("half", None, 0, ["halve"])),
    ],
)
def test_load_steps_that_make_none(name, bad, remedy):
    with rejected(name, remedy):
        checks.check_load_steps(**(STEPS | {name: bad}))


@pytest.mark.parametrize(("name", "bad"), [("rtol", True), ("rtol", 1j), ("max_it", True)])
def test_truth_values_are_no_numbers(name, bad):
    with rejected(f"{name} is {bad!r}"):
        checks.check_controls(**({"qp": "active-set", "rtol": 1e-6, "max_it": 50} | {name: bad}))


# -- the same on all ranks


@pytest.mark.mpi
def test_equal_values_pass_whatever_they_are():
    case = PressedBlocks()
    checks.check_same_on_all_ranks(
        COMM,
        number=1 if COMM.rank else np.float64(1.0),
        nothing=None,
        text="updated",
        levels=[0.1, np.nan] if COMM.rank else np.array([0.1, np.nan]),
        objects=[case.contact(), case.u, case.bcs()],  # the addresses differ
    )


@pytest.mark.mpi
def test_unequal_values_are_named():
    pairs = [(1.0, 1.0 + 1e-15), (None, 0.0), ("a", "b"), ([1.0], [1.0, 2.0]), ([[1]], [[2]])]
    for common, other in [*pairs, (0, False)]:
        value = other if COMM.rank == LAST else common
        if COMM.size == 1:
            checks.check_same_on_all_ranks(COMM, fine=1.0, value=value)
            continue
        with unequal("value"):
            checks.check_same_on_all_ranks(COMM, fine=1.0, value=value)


@pytest.mark.mpi
def test_long_values_are_shortened():
    if COMM.size > 1:
        with unequal("times") as caught:
            checks.check_same_on_all_ranks(COMM, times=[float(COMM.rank)] * 500)
        assert len(str(caught.value)) < 100 * COMM.size + 100


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["interfaces", "tags", "bcs", "geometry", "none"])
def test_arguments_of_a_problem_that_differ(name):
    """Without the check, the ranks would wait for each other in different places."""
    case = PressedBlocks()
    contact, bcs, last = case.contact(), case.bcs(), COMM.rank == LAST
    other = {
        "interfaces": {"interfaces": []},
        "tags": {"interfaces": [case.contact(slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)]},
        "bcs": {"bcs": bcs[:1]},
        "geometry": {"geometry": "reference"},
        "none": {"interfaces": None},
    }[name]
    given = {"interfaces": [contact], "bcs": bcs} | (other if last else {})
    solid = dm.Solid(case.u, ELASTIC)
    if COMM.size > 1:
        with unequal({"tags": "interfaces[0].slave", "none": "interfaces"}.get(name, name)):
            dm.ContactProblem(solid, **given)
    else:
        dm.ContactProblem(solid, [contact], bcs=bcs)


@pytest.mark.mpi
def test_controls_of_a_step_that_differ():
    problem = PressedBlocks().problem()
    if COMM.size > 1:
        with unequal("rtol"):
            dm.newton(problem, rtol=1e-8 if COMM.rank == LAST else 1e-6)
        with unequal("times"):
            next(dm.load_steps(problem, [1.0] if COMM.rank == LAST else [2.0]))
    assert dm.newton(problem).converged


@pytest.mark.mpi
def test_controls_that_differ():
    """Also if the value of one rank is wrong in itself: that rank would leave the others alone."""
    if COMM.size == 1:
        return
    problem = PressedBlocks().problem()
    for other in (1e-8, -1.0, None):
        with unequal("rtol"):
            dm.newton(problem, rtol=other if COMM.rank == LAST else 1e-6)
    for other in ("interior-point", "no backend", None):
        with unequal("qp"):
            dm.newton(problem, qp=other if COMM.rank == LAST else "active-set")
    with unequal("times"):
        times = [1.0] if COMM.rank == LAST else [1.0, 2.0]
        checks.check_load_steps(**(STEPS | {"times": times}), comm=COMM)
    with unequal("max_cuts"):
        checks.check_load_steps(**(STEPS | {"max_cuts": COMM.rank // LAST}), comm=COMM)
