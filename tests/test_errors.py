# SPDX-License-Identifier: MIT
"""Bad input: an error on all ranks that names the argument and the remedy, and nothing hangs."""

from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, mesh
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LEFT, TOP, TOP_OF_LOWER
from tests.cases.pressed_blocks import COMM, ELASTIC, PressedBlocks, rejected, some_rank

SIDES = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}
STEEL = {"E": 1000.0, "nu": 0.3, "Y": 1.0, "a": 10.0}


@pytest.fixture
def case():
    return PressedBlocks()


def ints(*values):
    return np.array(values, dtype=np.int32)


def mortar(case, **given):
    dm.assemble_mortar(**({"V": case.V, "facet_tags": case.facets} | SIDES | given))


def walk(case, **given):
    next(dm.load_steps(case.problem(), **({"times": [1.0]} | given)))


def step(case, **given):
    dm.newton(case.problem(), **given)


# -- what makes no sense anywhere

SOME = (None, True, 5, np.nan, 10**400, "x", b"x", [], {}, (), np.zeros((2, 2)), 1j, object)
EMPTY = [[], {}, ()]
INTEGERS = [5, 10**400]
CALLS = [  # a call, its arguments, those that are replaced by all these, and what they may be
    (dm.newton, lambda c: {"problem": c.problem()}, {"problem": [], "qp": [], "rtol": []}),
    (dm.newton, lambda c: {"problem": c.problem()}, {"max_it": INTEGERS}),
    (
        lambda **given: next(dm.load_steps(**given)),
        lambda c: {"problem": c.problem(), "times": [1.0]},
        {"problem": [], "times": EMPTY, "start": [None, 5], "max_cuts": INTEGERS, "cuts": []}
        | {"progress": [None, True], "on_time": [None, object]},
    ),
    *(
        (
            call,
            lambda c: {"V": c.V, "facet_tags": c.facets} | SIDES,
            {"V": [], "facet_tags": [], "slave": [5], "u": [None, object]},
        )
        for call in (dm.assemble_mortar, dm.segments)
    ),
    (dm.Contact, lambda c: {"facet_tags": c.facets} | SIDES, {"facet_tags": [], "slave": [5]}),
    (dm.Tags, lambda c: {"tags": c.facets, "names": {}}, {"tags": [], "names": EMPTY[1:2]}),
    (
        dm.Solid,
        lambda c: {"u": c.u, "materials": ELASTIC, "cell_tags": c.cells},
        {"u": [], "materials": [], "quadrature_degree": [None, 5]},
    ),
    (dm.Solid, lambda c: {"u": c.u, "materials": {1: ELASTIC}}, {"cell_tags": []}),
    (
        dm.ContactProblem,
        lambda c: {"solid": dm.Solid(c.u, ELASTIC)},
        {"solid": [], "interfaces": EMPTY, "bcs": EMPTY, "geometry": [], "loads": [None]}
        | {"petsc_options_prefix": ["x"]},
    ),
    (dm.VonMises, lambda c: dict(STEEL), {"E": [5], "nu": [], "Y": [5], "a": [5]}),
    (
        dm.write_summary,
        lambda c: {"path": "x.json", "problem": c.problem(), "steps": []},
        {"path": ["x", b"x"], "problem": [], "steps": [[], ()]},
    ),
    (dm.summarise, lambda c: {}, {"step": []}),
    (dm.qp.solve, lambda c: {}, {"qp": []}),
    (dm.qp.LinearSolver, lambda c: {"prefix": "x_"}, {"comm": []}),
    (
        lambda problem, path: problem.save(path),
        lambda c: {"problem": c.problem()},
        {"path": ["x", b"x"]},
    ),
    (
        lambda problem, name: problem.solid.max(name),
        lambda c: {"problem": c.problem()},
        {"name": ["x"]},
    ),
]


@pytest.mark.parametrize(("call", "good", "replaced"), CALLS)
def test_what_makes_no_sense_anywhere(case, call, good, replaced):
    """The error names the argument; none is that of a library below."""
    for name, takes in replaced.items():
        for bad in SOME:
            if repr(bad) not in map(repr, takes):
                with rejected(name):
                    call(**(good(case) | {name: bad}))
    assert not case.u.x.array.any()


# -- what is of the right type, and wrong


def solid_on(element):
    return lambda c: dm.Solid(fem.Function(fem.functionspace(c.mesh, element)), ELASTIC)


def load(make):
    """Return a call with a load that is made of the test function."""
    return lambda c: c.problem(loads=make(c, ufl.TestFunction(c.V)))


def single(c):
    """Return a space on a mesh in single precision."""
    domain = mesh.create_unit_square(COMM, 2, 2, dtype=np.float32)
    return fem.functionspace(domain, ("Lagrange", 1, (2,)))


def no_facets(domain):
    domain.topology.create_connectivity(domain.topology.dim - 1, domain.topology.dim)
    return mesh.meshtags(domain, domain.topology.dim - 1, ints(), ints())


def no_sides(V):
    dm.assemble_mortar(V, no_facets(V.mesh), slave=1, master=2)


def vectors_on(domain):
    return fem.functionspace(domain, ("Lagrange", 1, (domain.geometry.dim,)))


def of_component(c):
    """Return a condition on nodes of V, taken for dofs of a component."""
    return fem.dirichletbc(0.0, fem.locate_dofs_topological(c.V, 1, c.facets.find(1)), c.V.sub(1))


def twice(c):
    contact = c.contact()
    c.problem([contact, contact])


VECTOR = '("Lagrange", 1, (2,))'
BOTH = {1: ELASTIC, 2: ELASTIC}
REFUSED = [  # a call, and words of its message
    (lambda c: c.problem([c.contact(facets=PressedBlocks().facets)]), "facet_tags", "another mesh"),
    (
        lambda c: c.problem([c.contact(facets=c.cells)]),
        *("facet_tags", "dimension 2", "facets have dimension 1"),
    ),
    (lambda c: dm.Tags(c.facets, {"a": 1}).tag(2**31), "32 bits"),
    # spaces
    (solid_on(("Lagrange", 1)), "shape ()", VECTOR),
    (solid_on(("Lagrange", 3, (2,))), "degree 3", "degree 1 or 2"),
    (solid_on(("DG", 1, (2,))), "u ", "continuous vector Lagrange"),
    (lambda c: no_sides(vectors_on(mesh.create_unit_interval(COMM, 8))), "interval", "triangle"),
    (
        lambda c: dm.Solid(fem.Function(single(c), dtype=np.float32), ELASTIC),
        *("u holds a Function of type float32", "float64"),
    ),
    (
        lambda c: no_sides(single(c)),
        *("coordinates of the mesh are of type float32", "dtype=numpy.float64"),
    ),
    # materials
    (lambda c: dm.VonMises.from_uniaxial(1.0, 0.3, -1.0, 1.0), "yield_stress is -1.0"),
    (lambda c: dm.Solid(c.u, ELASTIC, quadrature_degree=31), "quadrature_degree is 31"),
    (lambda c: dm.Solid(c.u, {1: ELASTIC}, PressedBlocks().cells), "cell_tags", "of the same mesh"),
    (lambda c: dm.Solid(c.u, BOTH | {5: ELASTIC}, c.cells), "no cell has the tag 5"),
    (lambda c: dm.Solid(c.u, {1: ELASTIC, 2: dm.VonMises}, c.cells), "not a material"),
    # problems
    (lambda c: c.problem([c.facets]), "interfaces[0] is", "Contact or Tie"),
    (twice, "interfaces", "twice"),
    (lambda c: c.problem(bcs=[0.0]), "bcs: one is", "dirichletbc"),
    (lambda c: c.problem(bcs=[PressedBlocks().bc(BOTTOM)]), "bcs", "another space"),
    (
        lambda c: c.problem(bcs=[of_component(c)]),
        *("V.sub(1) at dofs of other components", "locate its dofs on V.sub(1)"),
    ),
    (load(lambda c, v: ufl.inner(v, ufl.TrialFunction(c.V)) * ufl.dx), "loads", "linear form"),
    (load(lambda c, v: ufl.TestFunction(PressedBlocks().V)[0] * ufl.dx), "loads", "test function"),
    (load(lambda c, v: fem.form(v[0] * ufl.dx)), "loads", "UFL"),
    # steps
    (lambda c: step(c, qp="simplex"), "qp is", "'active-set'", "'interior-point'"),
    (lambda c: step(c, rtol=1.0), "rtol", "give a"),
    (lambda c: step(c, max_it=0), "max_it", "give a"),
    (lambda c: walk(c, max_cuts=-1), "max_cuts", "an integer >= 0"),
    (lambda c: walk(c, times=np.array(1.0)), "times", "give a list", "[1.0]"),
]


@pytest.mark.parametrize("call", REFUSED)
def test_message(case, call):
    make, *words = call
    with rejected(*words) as caught:
        make(case)
    assert len(str(caught.value)) < 400  # no page of UFL
    assert not case.u.x.array.any()


def solid_without_a_cell(c):
    cells = np.setdiff1d(c.cells.indices, some_rank(c.cells.indices)[:1])
    dm.Solid(c.u, {1: ELASTIC}, mesh.meshtags(c.mesh, 2, cells, 0 * cells + 1))


def with_an_inner_facet(c):
    """Return the tags of both sides, and the slave's of a facet inside on one rank only."""
    c.mesh.topology.create_connectivity(1, 2)
    owned = np.arange(c.mesh.topology.index_map(1).size_local, dtype=np.int32)
    inside = np.setdiff1d(owned, mesh.exterior_facet_indices(c.mesh.topology))
    facets = np.concatenate([c.facets.indices, some_rank(inside)[:1]]).astype(np.int32)
    values = np.full(len(facets), TOP_OF_LOWER, dtype=np.int32)
    values[: len(c.facets.values)] = c.facets.values
    order = np.argsort(facets)
    return mesh.meshtags(c.mesh, 1, facets[order], values[order])


def no_entity(c, dim, tags, entity):
    """Return tags that mark, on one rank, an entity that there is not."""
    entities = np.sort(np.concatenate([tags.indices, some_rank(ints(entity))])).astype(np.int32)
    return mesh.meshtags(c.mesh, dim, entities, np.full_like(entities, TOP_OF_LOWER))


def no_dof(c, dof, component=None):
    dofs = some_rank(ints(dof))
    if component is None:
        return fem.dirichletbc(np.zeros(2), dofs, c.V)
    return fem.dirichletbc(0.0, dofs, c.V.sub(component))


def audit(c, slave, master, kind=dm.Contact):
    """Top and bottom of the pile do face each other, but only through both bodies."""
    c.problem([kind(c.facets, slave=slave, master=master)], bcs=[c.bc(LEFT)]).audit()


def nan_in(values):
    values[some_rank(np.arange(len(values)))[:1]] = np.nan


def nan_in_loads(c):
    force = fem.Function(c.V)
    nan_in(force.x.array)
    dm.newton(load(lambda c, v: ufl.inner(force, v) * ufl.dx)(c))


def nan_in_supports(c):
    value, dofs = fem.Function(c.V), fem.locate_dofs_topological(c.V, 1, c.facets.find(TOP))
    value.x.array[2 * some_rank(dofs[dofs < c.V.dofmap.index_map.size_local])[:1]] = np.nan
    dm.newton(c.problem(bcs=[c.bc(BOTTOM), fem.dirichletbc(value, dofs)]))


def nan_in_start(c):
    nan_in(c.u.x.array)
    step(c)


def nan_in_mesh(c, y, after=False):
    """Spoil a point of the left side, before or after the problem is made."""
    problem, x = c.problem() if after else None, c.mesh.geometry.x
    x[np.isclose(x[:, 1], y) & np.isclose(x[:, 0], 0.0), 0] = np.nan
    if y == 0.0:
        mortar(c)
    dm.newton(problem or c.problem())


NEVER = "never meet", "check the tags"
NO_DOF = "bcs holds a condition on the dof", "this rank has 0 to", "locate_dofs"
ON_ONE_RANK = [  # what only one rank may see
    *(
        (lambda c, s=s: c.problem([c.contact(**{s: 77})]), f"{s}=77", "marks no", "has the values")
        for s in ("slave", "master")
    ),
    (
        lambda c: c.problem([c.contact(facets=with_an_inner_facet(c))]),
        *(f"slave={TOP_OF_LOWER}", "1 facets inside", "mark exterior facets only"),
    ),
    (lambda c: audit(c, TOP, TOP_OF_LOWER), f"slave={TOP} and master={TOP_OF_LOWER}", *NEVER),
    (lambda c: audit(c, TOP, BOTTOM, dm.Tie), f"slave={TOP}", f"master={BOTTOM}", *NEVER),
    (
        solid_without_a_cell,
        *("materials", "no entry for 1 cells of the tags none", "tag all cells"),
    ),
    *(
        (lambda c, d=d, i=i: c.problem(bcs=[*c.bcs(), no_dof(c, d, i)]), *NO_DOF)
        for d, i in ((-1, None), (2**31 - 1, 0))
    ),
    *(
        (make, "tags mark the entity", f"of dimension {dim}", "this rank has 0 to")
        for dim, make in (
            (1, lambda c: c.problem([c.contact(facets=no_entity(c, 1, c.facets, 10**6))])),
            (2, lambda c: dm.Solid(c.u, {1: ELASTIC}, no_entity(c, 2, c.cells, -(2**31)))),
        )
    ),
    (nan_in_loads, "loads", "nan", "coefficients"),
    (nan_in_supports, "bcs: 1 values", "NaN", "check the values"),
    (nan_in_start, "u:", "finite displacement"),
    (lambda c: nan_in_mesh(c, -1.0, after=True), "coordinates", "check the mesh"),
    (lambda c: nan_in_mesh(c, 0.0), "coordinates", "finite"),
]


@pytest.mark.mpi
@pytest.mark.parametrize("call", ON_ONE_RANK)
def test_message_on_all_ranks(case, call):
    make, *words = call
    with rejected(*words):
        make(case)


@pytest.mark.mpi
def test_sides_that_supports_bring_together():
    """Each block beyond the other one, until the supports are told where to carry it."""
    b = PressedBlocks(gap=-3.0)
    problem = b.problem()
    b.top.value[:] = 0.0
    with rejected(*NEVER):
        problem.audit()
    b.top.value[:] = 0.0, 2.99
    assert problem.audit().interfaces[0].kept_nodes > 0
    assert dm.newton(problem).certificate.gap < 1e-8


def test_complex_build(case, monkeypatch):
    monkeypatch.setattr(PETSc, "ScalarType", np.complex128)
    for call in (lambda: dm.Solid(case.u, ELASTIC), lambda: mortar(case)):
        with rejected("complex", "real"):
            call()


def test_complex_values(case):
    """In a build for real numbers: numpy's would lose the imaginary part, or dolfinx refuse."""
    value = fem.Constant(case.mesh, np.array([0.0, 1j]))
    number = fem.Constant(case.mesh, np.array(1j))
    v = ufl.TestFunction(case.V)
    bc = fem.dirichletbc(value, ints(0), case.V)
    for call, name in (
        (lambda: case.problem(bcs=[bc]), "bcs holds"),
        (lambda: case.problem(potential=number * case.u[0] ** 2 * ufl.dx), "potential holds"),
        (lambda: dm.Solid(case.u, dm.Elastic(number, 0.3)), "Elastic: E holds"),
        (lambda: dm.Solid(fem.Function(case.V, dtype=np.complex128), ELASTIC), "u holds"),
        (lambda: dm.Tie(case.facets, **SIDES, jump=value), "jump holds"),
    ):
        with rejected(name, "real", "float64"):
            call()
    with rejected("holds a ufl.Coefficient", "dolfinx.fem"):
        case.problem(loads=ufl.inner(ufl.Coefficient(case.V), v) * ufl.dx)


@pytest.mark.mpi
def test_two_values_of_one_node(case):
    """At once, and in the step in which they part; in the corners, which two sides share."""
    side = fem.Constant(case.mesh, default_scalar_type((0.0, -0.02)))
    with rejected("bcs", " -0.02 and ", " for V.sub(1) at (0, ", "one of them"):
        case.problem(bcs=[case.bc(BOTTOM), case.bc(TOP, case.top), case.bc(LEFT, side)])
    case.top.value[:] = side.value[:] = 0.0
    problem = case.problem(bcs=[case.bc(TOP, case.top), case.bc(LEFT, side)])
    case.top.value[:] = side.value[:] = (0.1 + 0.2, 0.0)
    side.value[0] = 0.3 - 1e-17  # round-off
    problem.supports.values()
    side.value[0] = 0.3 + 1e-9
    with rejected("bcs", "0.300000001", "0.3 ", "V.sub(0) at (0, "):
        dm.newton(problem)
    assert not case.u.x.array.any()


@pytest.mark.mpi
def test_two_values_on_two_ranks(case):
    """One rank's condition has the node, another one's has its ghost."""
    dofs = fem.locate_dofs_topological(case.V, 1, case.facets.find(TOP))
    owned = dofs < case.V.dofmap.index_map.size_local
    zero, one = np.zeros(2), np.array([0.0, 1e-3])
    bcs = [fem.dirichletbc(zero, dofs[owned], case.V), fem.dirichletbc(one, dofs[~owned], case.V)]
    if COMM.allreduce(int((~owned).sum())):
        with rejected("bcs", "0 and 0.001 for V.sub(1) at ("):
            case.problem(bcs=[case.bc(BOTTOM), *bcs])


def test_what_becomes_no_number(case, value=np.nan):
    """Values of supports and coefficients, in the audit and in steps that are made afterwards."""
    stiffness = fem.Constant(case.mesh, value)
    problem = case.problem(potential=stiffness * (1.0 + case.u[0]) ** 2 * ufl.dx)
    for call in (problem.audit, lambda: dm.newton(problem)):
        with rejected(f"potential is {value}", "check its coefficients"):
            call()
        stiffness.value = 1.0
        assert dm.newton(problem).converged
        stiffness.value = value
    stiffness.value = 1.0
    case.top.value[1] = value
    with rejected("bcs", "NaN", "check the values"):
        dm.newton(problem)
