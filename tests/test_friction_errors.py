# SPDX-License-Identifier: MIT
"""Bad limits of friction: named with value and remedy, on all ranks, before anything has moved."""

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import CellType, create_unit_square
from dolfinx_mortar.interfaces import constraints
from dolfinx_mortar.interfaces.constraints import FrictionLaw
from tests.cases.friction import COMM, create
from tests.cases.meshes import two_blocks
from tests.cases.pressed_blocks import rejected, some_rank

NAMES = ["friction", "tresca"]


@pytest.fixture(scope="module")
def case():
    """Return blocks without friction."""
    return create("triangle")


def contact(case, **options):
    """Return another contact on the sides of the case."""
    return dm.Contact(case.contact.facet_tags, slave=3, master=4, **options)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf, -np.inf])
def test_numbers_that_are_no_limits(case, name, value):
    with rejected(name, repr(value), ">= 0"):
        contact(case, **{name: value})


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [True, False, "0.3", 0.3j, [0.3], (0.1, 0.2), {}])
def test_things_that_are_no_numbers(case, name, value):
    with rejected(name, repr(value), "number"):
        contact(case, **{name: value})


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [(0.1, 0.2), [[0.1]], 0.3j])
def test_constants_that_are_no_scalars(case, name, value):
    constant = fem.Constant(case.problem.V.mesh, np.asarray(value)[()])
    with rejected(name, "scalar"):
        contact(case, **{name: constant})


@pytest.mark.parametrize("name", NAMES)
def test_functions_that_are_no_scalars(case, name):
    with rejected(name, "shape (2,)", "scalar"):
        contact(case, **{name: fem.Function(case.problem.V)})


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("element", [("DG", 0), ("DG", 1), ("Bubble", 3), "quadrature"])
def test_functions_without_one_value_at_every_node(case, name, element):
    """Which of several were taken would depend on the numbering of cells, so on the ranks."""
    mesh = case.problem.V.mesh
    if element == "quadrature":
        element = basix.ufl.quadrature_element(mesh.basix_cell(), degree=2)
    with rejected(name, "not one value at every node", "interpolate"):
        contact(case, **{name: fem.Function(fem.functionspace(mesh, element))})
    with rejected(name, "collapse()"):
        contact(case, **{name: fem.Function(case.problem.V).sub(0)})


@pytest.mark.parametrize("name", NAMES)
def test_a_limit_is_given_once(case, name):
    """Its values may change, in a Constant or a Function; another one takes another contact."""
    value = fem.Constant(case.problem.V.mesh, 0.3)
    found = contact(case, **{name: value})
    other = NAMES[1 - NAMES.index(name)]
    assert getattr(found, name) is value and getattr(found, other) is None
    for each in NAMES:
        with pytest.raises(AttributeError, match=each):
            setattr(found, each, 0.1)


def test_an_array_is_no_limit(case):
    with rejected("friction", "number"):
        contact(case, friction=np.array([0.1, 0.2]))
    assert contact(case, friction=np.float64(0.3)).law.value == 0.3
    assert contact(case, friction=np.float32(0.5)).law.value == 0.5


def test_one_law_at_a_time(case):
    with rejected("friction is 0.3", "tresca is 2.0", "one of the two"):
        contact(case, friction=0.3, tresca=2.0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["function", "constant"])
def test_limits_on_another_mesh(case, name, kind):
    other, _, _ = two_blocks(COMM)
    space = fem.functionspace(other, ("Lagrange", 1))
    value = fem.Function(space) if kind == "function" else fem.Constant(other, 0.3)
    if kind == "constant":  # a number is the same on all meshes
        case.again(**{name: value}).solve(0.0, -0.01)
        return
    own = fem.Function(fem.functionspace(case.problem.V.mesh, ("Lagrange", 1)))
    for given in (value, own if COMM.rank else value):  # the others must not wait for one rank
        with rejected(name, "another mesh", "solid.mesh"):
            case.again(**{name: given})
    case.solve(0.0, -0.01)
    force, old = case.contact.force.copy(), case.problem
    bad = dm.Contact(case.contact.facet_tags, slave=4, master=3, **{name: value})
    with rejected(name, "another mesh"):
        dm.ContactProblem(old.solid, [case.contact, bad], bcs=case.bcs)
    assert np.array_equal(case.contact.force, force)  # the refused one has taken nothing
    assert dm.newton(old).converged


@pytest.mark.parametrize("name", NAMES)
def test_a_tie_has_no_friction(case, name):
    with rejected(name, "Tie", error=TypeError):
        dm.Tie(case.contact.facet_tags, slave=3, master=4, **{name: 0.3})


@pytest.mark.mpi
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("bad", [-0.2, np.nan, np.inf])
def test_a_constant_that_goes_bad_between_steps(case, name, bad):
    """The step is refused as a whole; with a good value it goes on."""
    value = fem.Constant(case.problem.V.mesh, 0.3)
    case = case.again(**{name: value})
    case.solve(0.0, -0.01)
    u, force = case.problem.u.x.array.copy(), case.contact.force.copy()
    value.value = bad
    case.push(0.01, -0.01)
    with rejected(name, f"{bad:g}" if COMM.size == 1 else "", "finite and >= 0"):
        dm.newton(case.problem)
    assert np.array_equal(case.problem.u.x.array, u)
    assert np.array_equal(case.contact.force, force)
    value.value = 0.1
    assert dm.newton(case.problem).converged


@pytest.mark.mpi
def test_a_zero_of_another_degree_is_no_negative_limit(monkeypatch):
    """Interpolation from another degree leaves round-off, at which nodes is luck: here at all."""
    grid = create_unit_square(COMM, 5, 5, CellType.quadrilateral)
    linear = fem.functionspace(grid, ("Lagrange", 1))
    given = fem.Function(linear)
    given.interpolate(lambda x: np.where(x[0] < 0.5, -1e-16, 0.3 + x[1]))
    law = FrictionLaw("friction", given)
    assert law.values(linear).min(initial=0.0) == 0.0
    monkeypatch.setattr(constraints, "ROUND_OFF", 0.0)
    with rejected("friction", "finite and >= 0"):
        law.values(linear)


@pytest.mark.mpi
@pytest.mark.parametrize("bad", [-0.2, np.nan])
def test_a_function_that_goes_bad_on_one_rank(case, bad):
    """All ranks learn of it."""
    space = fem.functionspace(case.problem.V.mesh, ("Lagrange", 1))
    value = fem.Function(space)
    value.x.array[:] = 0.3
    case = case.again(friction=value)
    case.solve(0.0, -0.01)
    u = case.problem.u.x.array.copy()
    own = space.dofmap.index_map.size_local
    value.x.array[some_rank(np.arange(own))[:1]] = bad
    case.push(0.01, -0.01)
    with rejected("friction", "finite and >= 0"):
        dm.newton(case.problem)
    assert np.array_equal(case.problem.u.x.array, u)
    assert COMM.allreduce(1, op=MPI.SUM) == COMM.size  # all are here


def test_results_of_friction_before_a_step(case):
    """The message says what to do."""
    fresh = case.again(friction=0.3)
    with pytest.raises(AttributeError, match="newton"):
        fresh.contact.gather(fresh.problem.u)
    with pytest.raises(AttributeError, match="friction="):
        case.contact.status  # noqa: B018


@pytest.mark.mpi
@pytest.mark.skipif(COMM.size == 1, reason="needs two ranks")
def test_a_constant_that_differs_between_the_ranks(case):
    value = fem.Constant(case.problem.V.mesh, 0.3)
    case = case.again(friction=value)
    value.value = 0.3 + 0.1 * COMM.rank
    case.push(0.0, -0.01)
    with rejected("friction differs between the ranks", "0.3 on rank 0", "0.4 on rank 1"):
        dm.newton(case.problem)
    value.value = 0.3
    assert dm.newton(case.problem).converged
