# SPDX-License-Identifier: MIT
"""Bad limits of friction: named with value and remedy, on all ranks, before anything has moved."""

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

LAWS = pytest.mark.parametrize("name", ["friction", "tresca"])


@pytest.fixture(scope="module")
def case():
    """Return blocks without friction."""
    return create("triangle")


def contact(case, **options):
    """Return another contact on the sides of the case."""
    return dm.Contact(case.contact.facet_tags, slave=3, master=4, **options)


def constant(value):
    return lambda V: fem.Constant(V.mesh, np.asarray(value)[()])


def function(*element):
    return lambda V: fem.Function(fem.functionspace(V.mesh, element))


def at_points(V):
    """Return a function without values at nodes."""
    element = basix.ufl.quadrature_element(V.mesh.basix_cell(), degree=2)
    return fem.Function(fem.functionspace(V.mesh, element))


JUMPS = ("not one value at every node", "interpolate")
WRONG = [
    (lambda V: np.nan, ("nan", ">= 0")),
    (lambda V: [0.3], ("[0.3]", "number")),
    (constant((0.1, 0.2)), ("scalar",)),
    (lambda V: fem.Function(V), ("shape (2,)", "scalar")),
    (lambda V: fem.Function(V).sub(0), ("collapse()",)),
    (function("DG", 0), JUMPS),
    (at_points, JUMPS),
]


@LAWS
@pytest.mark.parametrize(("make", "words"), WRONG)
def test_what_is_no_limit(case, name, make, words):
    with rejected(name, *words):
        contact(case, **{name: make(case.problem.V)})


@LAWS
def test_a_limit_is_given_once(case, name):
    """Its values may change, in a Constant or a Function; another one takes another contact."""
    value = fem.Constant(case.problem.V.mesh, 0.3)
    found = contact(case, **{name: value})
    assert getattr(found, name) is value and None in (found.friction, found.tresca)
    for each in ("friction", "tresca"):
        with pytest.raises(AttributeError, match=each):
            setattr(found, each, 0.1)
    with rejected("friction is 0.3", "tresca is 2.0", "one of the two"):
        contact(case, friction=0.3, tresca=2.0)
    with rejected(name, "Tie", error=TypeError):
        dm.Tie(case.contact.facet_tags, slave=3, master=4, **{name: 0.3})
    assert contact(case, **{name: np.float32(0.5)}).law.value == 0.5


@LAWS
def test_limits_on_another_mesh(case, name):
    """Other ranks do not wait for one that is wrong."""
    other, _, _ = two_blocks(COMM)
    value, own = (
        fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
        for mesh in (other, case.problem.V.mesh)
    )
    for given in (value, own if COMM.rank else value):
        with rejected(name, "another mesh", "solid.mesh"):
            case.again(**{name: given})
    case.solve(0.0, -0.01)
    force, old = case.contact.force.copy(), case.problem
    bad = dm.Contact(case.contact.facet_tags, slave=4, master=3, **{name: value})
    with rejected(name, "another mesh"):
        dm.ContactProblem(old.solid, [case.contact, bad], bcs=case.bcs)
    assert np.array_equal(case.contact.force, force)  # the refused one has taken nothing
    assert dm.newton(old).converged


def go_bad(value, bad):
    """Set a Constant everywhere, a Function on one rank."""
    if isinstance(value, fem.Constant):
        value.value = bad
    else:
        own = value.function_space.dofmap.index_map.size_local
        value.x.array[some_rank(np.arange(own))[:1]] = bad


@pytest.mark.mpi
@LAWS
@pytest.mark.parametrize(
    ("make", "bad"), [(constant(0.3), -0.2), (function("Lagrange", 1), np.nan)]
)
def test_a_limit_that_goes_bad_between_steps(case, name, make, bad):
    """The step is refused as a whole, on all ranks; with a good value it goes on."""
    value = make(case.problem.V)
    case = case.again(**{name: value})
    case.solve(0.0, -0.01)
    u, force = case.problem.u.x.array.copy(), case.contact.force.copy()
    go_bad(value, bad)
    case.push(0.01, -0.01)
    said = f"{bad:g}" if isinstance(value, fem.Constant) and COMM.size == 1 else ""
    with rejected(name, said, "finite and >= 0"):
        dm.newton(case.problem)
    assert np.array_equal(case.problem.u.x.array, u)
    assert np.array_equal(case.contact.force, force)
    go_bad(value, 0.1)
    assert dm.newton(case.problem).converged


@pytest.mark.mpi
def test_a_zero_of_another_degree_is_no_negative_limit(monkeypatch):
    """Interpolation from another degree leaves round-off, at which nodes is luck: here at all."""
    grid = create_unit_square(COMM, 5, 5, CellType.quadrilateral)
    linear = fem.functionspace(grid, ("Lagrange", 1))
    given = fem.Function(linear)
    given.interpolate(lambda x: np.where(x[0] < 0.5, -1e-16, 0.3 + x[1]))
    law = FrictionLaw("friction", given)
    at = {"pressure": fem.Function(linear)}
    assert law.values(at).min(initial=0.0) == 0.0
    monkeypatch.setattr(constraints, "ROUND_OFF", 0.0)
    with rejected("friction", "finite and >= 0"):
        law.values(at)


def test_results_without_friction(case):
    with pytest.raises(AttributeError, match="friction="):
        case.contact.status  # noqa: B018
