# SPDX-License-Identifier: MIT
"""Invalid jumps: an error on all ranks that names the remedy, and no change of the state."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.glued_bar import COMM, Bar
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.cases.pressed_blocks import rejected, some_rank

pytestmark = pytest.mark.mpi


@pytest.fixture
def case():
    return Bar("quadrilateral")


def glue(case, jump):
    return dm.Tie(case.facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER, jump=jump)


@pytest.mark.parametrize("jump", [0.1, [0.1], "up", [0.1, None], (0.0, 1j), (0, 10**400)])
def test_a_jump_of_the_wrong_shape_or_kind(case, jump):
    with rejected("jump is ", "give 2 Cartesian components", "[0, 0.1]"):
        glue(case, jump)
    with rejected("jump is "):
        case.tie.jump = jump
    assert case.tie.jump is None


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite(case, bad):
    with rejected("jump is ", "finite"):
        glue(case, [0.0, bad])
    with rejected("finite"):
        case.tie.tightening = [bad, 0.0]


@pytest.mark.parametrize("what", ["jump", "tightening"])
def test_a_jump_beyond_the_model(case, what):
    """Longer than its diagonal, which is that of 1 x 2: a mistake of units."""
    problem = case.problem([case.hold(BOTTOM)])
    setattr(case.tie, what, [0.0, 2.25])
    with rejected("jump: ", "a component of 2.25", "diagonal, 2.236", "unit of the mesh"):
        dm.newton(problem)
    setattr(case.tie, what, [0.0, 2.2])
    assert dm.newton(problem).converged


def test_constants_and_functions_of_the_wrong_shape(case):
    scalar, of_cells = ("Lagrange", 1), ("DG", 0, (2,))
    for jump, *words in (
        (fem.Constant(case.mesh, 0.1), "jump is a Constant of shape ()", "give 2"),
        (fem.Function(fem.functionspace(case.mesh, scalar)), "values of shape ()", "give 2"),
        (fem.Function(fem.functionspace(case.mesh, of_cells)), "not one value at every node"),
        (case.u.sub(1), "part of a Function", "collapse()"),
        (2.0 * case.u, "expression of UFL", "interpolate"),
        (ufl.SpatialCoordinate(case.mesh), "expression of UFL"),
    ):
        with rejected(*words):
            glue(case, jump)


@pytest.mark.parametrize("kind", ["Constant", "Function"])
def test_a_jump_on_another_mesh(case, kind):
    other = Bar("quadrilateral")
    jump = fem.Constant(other.mesh, np.zeros(2)) if kind == "Constant" else fem.Function(other.V)
    with rejected(f"jump is a {kind} on another mesh", "solid.mesh"):
        dm.ContactProblem(case.solid, [glue(case, jump)], bcs=[case.hold(BOTTOM)])
    problem = case.problem([case.hold(BOTTOM)])
    own = fem.Constant(case.mesh, np.zeros(2)) if kind == "Constant" else fem.Function(case.V)
    for given in (jump, own if COMM.rank else jump):  # the others must not wait for one rank
        case.tie.jump = given  # only a problem knows its mesh
        with rejected(f"jump is a {kind} on another mesh"):
            dm.newton(problem)


def spoilt(kind, case):
    """Return a jump that is no good, in most cases on one rank only, and what is said of it."""
    x = case.V.tabulate_dof_coordinates()[: case.V.dofmap.index_map.size_local]
    there = len(some_rank(x[np.abs(x[:, 1]) < 1e-12])) > 0  # a rank that has a part of the slave

    def fails(x):
        if there:
            raise ValueError("no such depth")
        return np.zeros((2, x.shape[1]))

    function, constant = fem.Function(case.V), fem.Constant(case.mesh, np.array([0.0, np.inf]))
    function.x.array[:] = np.nan if there else 0.0
    shape = slice(None, None, -1 if there else 1)
    return {
        "Function": (function, "jump", "values", "NaN or infinite"),
        "Constant": (constant, "jump", "values", "NaN or infinite"),
        "values": (lambda x: function.x.array[0] + np.zeros_like(x[:2]), "NaN or infinite"),
        "complex": (lambda x: 1j * x[:2], "jump(x) is ", "real numbers"),
        "shape": (lambda x: np.zeros(x[:2].shape[shape]), "jump(x) is ", "a vector for each of"),
        "error": (fails, "no such depth"),
    }[kind]


@pytest.mark.parametrize("kind", ["Function", "Constant", "values", "complex", "shape", "error"])
def test_a_jump_that_is_no_good_leaves_all_as_it_was(case, kind):
    """The step before stays, and the next one with a good jump is as if nothing had been."""
    problem = case.problem([case.hold(BOTTOM)])
    case.tie.jump = [1e-3, 2e-3]
    dm.newton(problem)
    before, force = case.u.x.array.copy(), case.tie.force.copy()
    case.tie.jump, *words = spoilt(kind, case)
    with rejected(*words):
        dm.newton(problem)
    assert np.array_equal(case.u.x.array, before) and np.array_equal(case.tie.force, force)
    case.tie.jump = [0.0, 1e-3]
    dm.newton(problem)
    assert case.error(lambda x, upper: upper[:, None] * np.array([0.0, 1e-3])) < 1e-12
