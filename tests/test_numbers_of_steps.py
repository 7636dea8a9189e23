# SPDX-License-Identifier: MIT
"""Every number of laws, steps and interfaces, halved and doubled: the answer stays the same."""

import ast
import importlib
import sys
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.interfaces.link import predict_active
from dolfinx_mortar.problem.linearisation import find_balance
from tests import (
    test_analytic,
    test_audit,
    test_finite_strain,
    test_kinematics,
    test_law_check,
    test_materials,
    test_multigrid,
    test_newton,
    test_plane_stress,
)
from tests.cases.block_piles import ABOVE, BELOW, PILE, WEST, Blocks
from tests.cases.hertz import ELASTIC, PLASTIC, create_case
from tests.cases.meshes import TOP
from tests.cases.pressed_blocks import PressedBlocks
from tests.sweep.problems import create

COMM = MPI.COMM_WORLD
LAYERS = (
    "audit",
    "persistence",
    "problem",
    "report",
    "steps",
    "interfaces",
    "materials",
    "solid",
)
PACKAGE = Path(dm.__file__).parent
NUMBERS = {
    "interfaces.link": ("OVERLAP",),
    "audit.audit": ("COARSE",),
    "steps.failures": ("SOFT", "SQUEEZED"),
    "steps.line_search": ("ARMIJO",),
    "problem.contacts": ("FORCING", "DIGIT"),
}
# judged below, in test_smooth_contact, test_resolution, in
# test_edges, in those of checkpoints, in test_pretension, in test_friction_patch, in
# test_tie_reach, in test_small_strain, and in test_ramp
OTHERS = {
    "interfaces.constraints",  # in test_friction_patch
    "interfaces.contact",
    "interfaces.obstacle",  # in test_obstacle
    "steps.driven_tools",  # in test_driven_tools
    "interfaces.interface",
    "interfaces.tie",
    "audit.audit",  # in test_smooth_contact
    "report.notes",
    "report.penetration",
    "report.certificate",
    # in test_exact_tangent and test_load_steps
    "interfaces.moving_geometry",
    "steps.subproblem",  # in test_finite_strain, too
    "steps.newton",
    "steps.energy_ledger",  # in test_dynamics
    "persistence.checkpoints",  # in those of checkpoints
    "materials.creep",  # in test_creep, which three rounds fail
    "materials.logarithmic",  # in test_logarithmic_laws
    "materials.logarithms",
}
TABLES = {"COMPONENTS", "INDEX", "TURNS", "UNTAGGED"}  # how tensors are stored, and a mark
TABLES |= {"NORMAL", "GRADIENT"}  # the tensor of a strain out of the plane, a layout
TABLES |= {"POSITIVE", "NOT_NEGATIVE"}  # ranges of parameters
TABLES |= {"HIGHEST_RULE"}  # what is refused, in test_errors
TABLES |= {"FINITE_RTOL", "STRETCHES", "VOLUMES", "WEIGHTS"}  # in test_law_check


def check_laws():
    """Accept a law and refuse another one."""
    report = dm.materials.check(test_law_check.VOCE)
    assert report.changed > 0 and report.tangent_error < 1e-8
    wrong = test_law_check.von_mises(updated_state=test_law_check.Slips.slow)
    for law in (test_law_check.DIFFERS, wrong):
        test_law_check.test_check_finds_what_does_not_fit(law, {}, ())


def flow():
    test_materials.POINTS.pop("any", None)  # compiled with the number
    test_materials.test_any_hardening_satisfies_the_flow_rule()


def in_plane_stress():
    test_plane_stress._POINTS.clear()
    test = test_plane_stress.test_plane_stress_is_the_spatial_law_without_stress_out_of_the_plane
    test("arrays", np.random.default_rng(1))


def fit():
    test_analytic.test_fit_leaves_out_the_edge(2.0)


# Module and number: absurd factors, each of which fails the test that reads it.
OF_LAWS = {
    ("materials.plasticity", "YIELD_TOLERANCE"): ((1e-10, 1e9), flow),
    ("materials.plasticity", "EPS"): ((0.0, 1e14), check_laws),
    ("materials.law_check", "PATHS"): ((0,), check_laws),
    ("materials.law_check", "RTOL"): ((1e-10, 1e5), check_laws),
    ("materials.law_check", "LENGTHS"): ((1e-8, 1e9), check_laws),
    ("materials.law_check", "SIZES"): ((1e-6,), check_laws),
    ("materials.response", "HALF_OF_DIGITS"): ((1e7,), in_plane_stress),
    ("materials.response", "LIMIT"): ((0.02,), in_plane_stress),
    ("solid.kinematics", "ROUND_OFF"): ((0.0, 1e16), test_kinematics.test_a_free_axis_is_refused),
    ("analytic", "EDGE"): ((1e-6, 11.0), fit),
    ("analytic", "HALF_OF_DIGITS"): ((1e8,), fit),
}
FAILURES = AssertionError, ValueError, dm.NewtonNotConverged, pytest.fail.Exception


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize(("module", "name"), OF_LAWS)
def test_a_number_of_laws_is_felt(module, name, monkeypatch):
    where = importlib.import_module(f"dolfinx_mortar.{module}")
    absurd, test = OF_LAWS[module, name]
    value = getattr(where, name)
    for factor in (0.5, 2.0, *absurd):
        scaled = tuple(np.multiply(factor, value)) if isinstance(value, tuple) else factor * value
        monkeypatch.setattr(where, name, type(value)(scaled))
        if factor in absurd:
            with pytest.raises(FAILURES):
                test()
        else:
            test()


def numbers_in(file):
    """Return the names of the numbers that a module defines."""
    found = []
    for node in ast.parse(file.read_text()).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value = getattr(node, "value", None)
        if value is None or not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        has_number = any(
            isinstance(part, ast.Constant) and type(part.value) in (int, float)
            for part in ast.walk(value)
        ) or "finfo" in ast.dump(value)
        names = [n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
        found += [name for name in names if has_number and name.isupper()]
    return found


def test_no_number_is_left_out():
    felt = {f"{module}.{name}" for module, names in NUMBERS.items() for name in names}
    felt |= {f"{module}.{name}" for module, name in OF_LAWS}
    files = [
        PACKAGE / "analytic.py",
        *(f for room in LAYERS for f in (PACKAGE / room).glob("*.py")),
    ]
    for file in files:
        module = ".".join(file.relative_to(PACKAGE).with_suffix("").parts)
        if module not in OTHERS:
            assert {f"{module}.{n}" for n in numbers_in(file) if n not in TABLES} <= felt, module


class Seen(NamedTuple):
    """What a user would look at."""

    numbers: np.ndarray  # forces, moments, stresses
    texts: tuple  # what is said of problems that cannot be solved
    counts: tuple  # what the solution cost


def observe():
    """Return what comes of an audit, of two plastic steps, the second with sliding, of failures."""
    case = create_case(dm.meshing.hertz(COMM, kind="graded", h=1.2), PLASTIC, slave="disc")
    numbers, counts = [len(case.problem.audit().warnings)], []
    for x, depth in ((0.0, 0.2), (0.3, 0.25)):
        case.top.value[:] = (x, -depth)
        report = dm.newton(case.problem, rtol=1e-10)
        case.problem.commit()
        numbers += [case.force, *case.contact.moment, case.problem.solid.max("von_mises")]
        counts += [(i.updates, i.linear_iterations, i.line_search_steps) for i in report.iterations]
    links = case.problem.system.links
    counts.append((*(int(link.constrained.sum()) for link in links), guess_at_an_overlap()))
    return Seen(np.array(numbers), (floating(), pulled()), tuple(counts))


def guess_at_an_overlap():
    """Return how many nodes are guessed to be in contact where the sides overlap."""
    mesh = dm.meshing.hertz(COMM, kind="graded", h=0.3, gap=-0.1)
    case = create_case(mesh, ELASTIC, geometry="reference")
    problem = case.problem
    problem.audit()
    system, n = problem.system, problem.n
    balance = find_balance(problem, problem.begin_step())
    x, length = problem.positions(), system.facet_length
    return int(predict_active(system.links, x, n, balance.nodes, length).sum())


def message_of(step):
    """Return the error of a step that fails, or that there was none."""
    try:
        step()
    except (ValueError, dm.NewtonNotConverged) as error:
        return getattr(error, "message", str(error))
    return "no error"


def floating():
    """Return what is said of two blocks of which one is held."""
    case = PressedBlocks()
    return message_of(lambda: dm.newton(case.problem(bcs=[case.bc(TOP)])))


def pulled():
    """Return what is said of a bar that is pulled beyond what it carries."""
    b = Blocks(PILE[:1])
    law = dm.VonMises.from_uniaxial(1000.0, 0.3, 10.0, 0.0)
    bcs = [b.fix(1, BELOW, component=1), b.fix(1, WEST, component=0)]
    problem = b.problem([], bcs, law=law, loads=b.traction(1, ABOVE, (0.0, 13.0)))
    return message_of(lambda: dm.newton(problem))


def set_everywhere(monkeypatch, module, name, factor):
    """Multiply a number in all modules that know it, also those that imported it by name."""
    where = importlib.import_module(f"dolfinx_mortar.{module}")
    value = getattr(where, name)
    if isinstance(value, dict):
        changed = {key: factor * number for key, number in value.items()}
    else:
        changed = type(value)(factor * value)
    for known, imported in list(sys.modules.items()):
        if known.startswith("dolfinx_mortar") and vars(imported).get(name) is value:
            monkeypatch.setattr(imported, name, changed)


@pytest.fixture(scope="module")
def usual():
    return observe()


ALL = [(module, name) for module, names in NUMBERS.items() for name in names]
ALL += [("common.arrays", "ROUND_OFF"), ("common.arrays", "QUARTER_OF_DIGITS")]


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(("module", "name"), ALL)
def test_half_and_double(module, name, factor, usual, monkeypatch):
    set_everywhere(monkeypatch, module, name, factor)
    seen = observe()
    assert seen.numbers == pytest.approx(usual.numbers, rel=1e-8, abs=1e-6)
    assert seen.texts == usual.texts
    probe(module, name)


# -- numbers that the above does not read: tests that do, and fail where they are absurd -----------


def closed_round_off():
    """Asked for all digits, a step ends although its gaps are none better than coordinates."""
    case = create("pile", 13)
    options = {"on_time": case.on_time, "rtol": 1e-12, "cuts": "none"}
    (step,) = dm.load_steps(case.problem, case.levels[:1], **options)
    assert step.report.newton_iterations <= 3


ROWS = (((13, 21), (23, 31)), dm.Tie, (), f"xyz of the bodies around {test_audit.ALL} together")
PROBES = {
    "QUARTER_OF_DIGITS": lambda: test_audit.test_free_motions_by_simple_names(*ROWS),
    "SQUEEZED": test_finite_strain.test_cells_that_invert,
    "ARMIJO": test_newton.test_a_step_too_long_is_halved,
    "common.arrays.ROUND_OFF": closed_round_off,
    "DIGIT": test_multigrid.test_a_step_that_stalls_asks_for_more_accurate_programs,
}


def probe(module, name):
    """Run the test that reads a number, if the steps above do not."""
    PROBES.get(f"{module}.{name}", PROBES.get(name, lambda: None))()


ABSURD = {"ARMIJO": 1e12, "common.arrays.ROUND_OFF": 1e-12}  # 0 for the others


@pytest.mark.slow
@pytest.mark.serial  # the counts are those of one rank
@pytest.mark.parametrize(("module", "name"), ALL)
def test_an_absurd_number_is_felt(module, name, usual, monkeypatch):
    """By what a user sees, by what it costs, or because nothing works any more."""
    set_everywhere(monkeypatch, module, name, ABSURD.get(f"{module}.{name}", ABSURD.get(name, 0.0)))
    try:
        seen = observe()
        probe(module, name)
    except FAILURES:
        return
    same = seen.numbers == pytest.approx(usual.numbers, rel=1e-8, abs=1e-6)
    assert not same or (seen.texts, seen.counts) != (usual.texts, usual.counts)


# -- the one number that is a decision -------------------------------------------------------------


@pytest.mark.parametrize(("degrees", "kept"), [(5, True), (80, True), (86, False)])
def test_a_normal_that_dirichlet_data_take(degrees, kept):
    """A slave normal keeps its contact while a tenth of it, 84 degrees, is left free."""
    length = np.cos(np.radians(degrees))
    contact = dm.Contact.__new__(dm.Contact)
    assert bool(contact.may_carry(np.array([length]), np.zeros((1, 2), dtype=bool))[0, 0]) == kept
