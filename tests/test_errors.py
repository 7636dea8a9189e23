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


@pytest.fixture
def case():
    return PressedBlocks()


def tags_like(case, entities, value=TOP_OF_LOWER, dim=1):
    entities = np.unique(np.asarray(entities, dtype=np.int32))
    return mesh.meshtags(case.mesh, dim, entities, np.full(len(entities), value, dtype=np.int32))


# -- surfaces and tags


def test_the_unspoilt_case_works(case):
    report = dm.newton(case.problem())
    assert report.converged and report.certificate.active_nodes > 0


@pytest.mark.mpi
@pytest.mark.parametrize("side", ["slave", "master"])
def test_tag_that_marks_nothing(case, side):
    with rejected(f"{side}=77", "marks no facet", "has the values"):
        case.problem([case.contact(**{side: 77})])


@pytest.mark.mpi
def test_interior_facets_on_one_rank_only(case):
    tdim = case.mesh.topology.dim
    case.mesh.topology.create_connectivity(tdim - 1, tdim)
    exterior = mesh.exterior_facet_indices(case.mesh.topology)
    owned = np.arange(case.mesh.topology.index_map(1).size_local, dtype=np.int32)
    inside = some_rank(np.setdiff1d(owned, exterior))[:1]
    facets = tags_like(case, np.concatenate([case.facets.find(TOP_OF_LOWER), inside]))
    values = facets.values.copy()
    both = np.concatenate([facets.indices, case.facets.find(BOTTOM_OF_UPPER)])
    values = np.concatenate([values, case.facets.values[case.facets.values == BOTTOM_OF_UPPER]])
    order = np.argsort(both)
    facets = mesh.meshtags(case.mesh, 1, both[order], values[order])
    with rejected(f"slave={TOP_OF_LOWER}", "1 facets inside", "mark exterior facets only"):
        case.problem([case.contact(facets=facets)])


def test_same_tag_on_both_sides(case):
    with rejected("slave and master", "two different tags"):
        dm.Tie(case.facets, slave=3, master=3)


def test_tags_of_another_mesh(case):
    with rejected("facet_tags", "another mesh"):
        case.problem([case.contact(facets=PressedBlocks().facets)])


def test_tags_of_cells(case):
    with rejected("facet_tags", "dimension 2", "facets have dimension 1"):
        case.problem([case.contact(facets=case.cells)])


@pytest.mark.parametrize("tags", [None, "facets", 3])
def test_tags_of_a_wrong_type(case, tags):
    with rejected("facet_tags", "MeshTags"):
        dm.Contact(tags, slave=3, master=4)
    with rejected("facet_tags", "MeshTags"):
        dm.assemble_mortar(case.V, tags, slave=3, master=4)


@pytest.mark.parametrize("tag", ["3", 3.0, None, (3, 5)])
def test_tag_that_is_no_integer(case, tag):
    with rejected("slave is", "integer"):
        case.contact(slave=tag)


@pytest.mark.mpi
def test_sides_that_never_face_each_other(case):
    with rejected(f"slave={TOP} and master={TOP_OF_LOWER}", "never meet", "check the tags"):
        case.problem([case.contact(slave=TOP, master=TOP_OF_LOWER)]).audit()


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_sides_beyond_each_other(case, kind):
    """Top and bottom of the pile do face each other, but only through both bodies."""
    interface = kind(case.facets, slave=TOP, master=BOTTOM)
    bcs = [case.bc(LEFT)]
    with rejected(f"slave={TOP}", f"master={BOTTOM}", "never meet", "check the tags"):
        case.problem([interface], bcs=bcs).audit()


@pytest.mark.mpi
def test_sides_that_supports_bring_together():
    """Each block beyond the other one, until the supports are told where to carry it."""
    b = PressedBlocks(gap=-3.0)
    problem = b.problem()
    b.top.value[:] = 0.0
    with rejected("never meet", "check the tags"):
        problem.audit()
    b.top.value[:] = 0.0, 2.99
    assert problem.audit().interfaces[0].kept_nodes > 0
    assert dm.newton(problem).certificate.gap < 1e-8


# -- spaces


@pytest.mark.parametrize(
    ("element", "words"),
    [
        (("Lagrange", 1), ("shape ()", '("Lagrange", 1, (2,))')),
        (("Lagrange", 3, (2,)), ("degree 3", "degree 1 or 2")),
        (("DG", 1, (2,)), ("u ", "continuous vector Lagrange")),
        (("Lagrange", 1, (3,)), ("shape (3,)", '("Lagrange", 1, (2,))')),
    ],
)
def test_space(case, element, words):
    V = fem.functionspace(case.mesh, element)
    with rejected(*words):
        dm.Solid(fem.Function(V), ELASTIC)
    if element != ("Lagrange", 1):
        with rejected("V", "degree 1"):
            dm.assemble_mortar(V, case.facets, slave=3, master=4)


@pytest.mark.parametrize("domain", ["interval", "prism"])
def test_cells_not_supported_in_contact(domain):
    if domain == "interval":
        other = mesh.create_unit_interval(COMM, 8)
    else:
        other = mesh.create_unit_cube(COMM, 2, 2, 2, mesh.CellType.prism)
    d = other.geometry.dim
    V = fem.functionspace(other, ("Lagrange", 1, (d,)))
    other.topology.create_connectivity(d - 1, d)
    none = np.empty(0, dtype=np.int32)
    facets = mesh.meshtags(other, d - 1, none, none)
    with rejected(domain, "triangle"):
        dm.assemble_mortar(V, facets, slave=1, master=2)


def test_a_mesh_is_no_displacement(case):
    with rejected("u is", "Function"):
        dm.Solid(case.mesh, ELASTIC)


def test_displacement_of_another_space(case):
    with rejected("u has to be a Function of V"):
        dm.assemble_mortar(case.V, case.facets, slave=3, master=4, u=PressedBlocks().u)


def test_complex_build(case, monkeypatch):
    contact = case.contact()
    monkeypatch.setattr(PETSc, "ScalarType", np.complex128)
    with rejected("complex", "real"):
        dm.Solid(case.u, ELASTIC)
    with rejected("complex", "real"):
        dm.assemble_mortar(case.V, contact.facet_tags, slave=3, master=4)


# -- materials


@pytest.mark.parametrize(
    ("bad", "name"),
    [
        ({"E": 0.0}, "E"),
        ({"E": -1.0}, "E"),
        ({"nu": 0.5}, "nu"),
        ({"nu": -1.0}, "nu"),
        ({"Y": 0.0}, "Y"),
        ({"a": -1.0}, "a"),
        ({"E": np.nan}, "E"),
        ({"Y": np.inf}, "Y"),
        ({"E": "x"}, "E"),
        ({"nu": np.array([0.1, 0.2])}, "nu"),
        ({"E": True}, "E"),
        ({"E": 10**400}, "E"),
    ],
)
def test_material_constants(bad, name):
    good = {"E": 1000.0, "nu": 0.3, "Y": 1.0, "a": 10.0}
    with rejected(f"VonMises: {name} is ", "finite number"):
        dm.VonMises(**(good | bad))
    if name in ("E", "nu"):
        elastic = {k: v for k, v in (good | bad).items() if k in ("E", "nu")}
        with rejected(f"Elastic: {name} is ", "finite number"):
            dm.Elastic(**elastic)


@pytest.mark.parametrize("name", ["yield_stress", "plastic_modulus"])
def test_uniaxial_constants_by_the_names_of_their_arguments(name):
    test = {"yield_stress": 450.0, "plastic_modulus": 15e3}
    with rejected(f"from_uniaxial: {name} is -1.0"):
        dm.VonMises.from_uniaxial(200e3, 0.3, **(test | {name: -1.0}))


@pytest.mark.parametrize("degree", ["a", -1, 1.5, True, 31, 10**9])
def test_quadrature_degree(case, degree):
    with rejected(f"quadrature_degree is {degree!r}", "integer"):
        dm.Solid(case.u, ELASTIC, quadrature_degree=degree)


@pytest.mark.mpi
def test_cells_without_material(case):
    with rejected("materials", "no entry for", "the tags 2", "add one for each"):
        dm.Solid(case.u, {1: ELASTIC}, case.cells)


@pytest.mark.mpi
def test_cells_without_tag_on_one_rank_only(case):
    left_out = some_rank(case.cells.indices)[:1]
    kept = np.setdiff1d(case.cells.indices, left_out)
    cells = mesh.meshtags(case.mesh, 2, kept, np.ones(len(kept), dtype=np.int32))
    with rejected("materials", "no entry for 1 cells of the tags none", "tag all cells"):
        dm.Solid(case.u, {1: ELASTIC}, cells)


def test_material_of_no_cell(case):
    with rejected("materials", "no cell has the tag 9", "cell_tags has 1, 2"):
        dm.Solid(case.u, {1: ELASTIC, 2: ELASTIC, 9: ELASTIC}, case.cells)


@pytest.mark.parametrize("cells", ["none", "other mesh", "facets"])
def test_cell_tags(case, cells):
    tags = {"none": None, "other mesh": PressedBlocks().cells, "facets": case.facets}[cells]
    with rejected("cell_tags"):
        dm.Solid(case.u, {1: ELASTIC, 2: ELASTIC}, tags)


@pytest.mark.parametrize(
    "law", [None, 200e3, dm.Elastic, {1: dm.Elastic, 2: ELASTIC}, {}, {"1": ELASTIC}]
)
def test_what_is_no_material(case, law):
    with rejected("materials"):
        dm.Solid(case.u, law, case.cells)


# -- the problem's other arguments


def test_arguments_of_a_wrong_type(case):
    solid = dm.Solid(case.u, ELASTIC)
    for arguments, words in (
        ((case.u,), ("solid is", "Solid(u")),
        ((solid, case.contact()), ("interfaces is", "give a list")),
        ((solid, ["contact"]), ("interfaces[0] is", "Contact or Tie")),
        ((solid, [case.facets]), ("interfaces[0] is", "Contact or Tie")),
    ):
        with rejected(*words):
            dm.ContactProblem(*arguments)
    with rejected("bcs is", "give a list"):
        dm.ContactProblem(solid, bcs=case.bcs()[0])
    with rejected("bcs: one is", "dirichletbc"):
        dm.ContactProblem(solid, bcs=[0.0])
    for name in ("interfaces", "bcs"):
        with rejected(f"{name} is None", "[] for none"):
            dm.ContactProblem(solid, **{name: None})
    contact = case.contact()
    with rejected("interfaces", "twice"):
        dm.ContactProblem(solid, [contact, contact])


@pytest.mark.parametrize("geometry", ["current", None, ""])
def test_geometry_mode(case, geometry):
    with rejected("geometry is", "'updated' or 'reference'"):
        case.problem(geometry=geometry)


@pytest.mark.parametrize("qp", ["simplex", None, "bound-qp"])
def test_backend(case, qp):
    with rejected("qp is", "'active-set'", "'interior-point'"):
        dm.newton(case.problem(), qp=qp)


@pytest.mark.parametrize(
    "bad",
    [
        *({"rtol": value} for value in (0.0, -1.0, 1.0, np.nan, "1", None)),
        *({"max_it": value} for value in (0, 2.5, "9")),
    ],
)
def test_tolerances(case, bad):
    with rejected(next(iter(bad)), "give a"):
        dm.newton(case.problem(), **bad)


@pytest.mark.parametrize("where", ["other mesh", "scalar space", "equal space"])
def test_conditions_on_another_space(case, where):
    if where == "other mesh":
        bc = PressedBlocks().bc(BOTTOM)
    elif where == "equal space":
        twin = fem.functionspace(case.mesh, ("Lagrange", 1, (2,)))
        bc = fem.dirichletbc(fem.Function(twin), np.arange(1, dtype=np.int32))
    else:
        Q = fem.functionspace(case.mesh, ("Lagrange", 1))
        dofs = fem.locate_dofs_topological(Q, 1, case.facets.find(BOTTOM))
        bc = fem.dirichletbc(default_scalar_type(0), dofs, Q)
    with rejected("bcs", "another space", "u.function_space"):
        case.problem(bcs=[bc])


@pytest.mark.mpi
def test_conditions_on_components_are_welcome(case):
    collapsed, _ = case.V.sub(1).collapse()
    value = fem.Function(collapsed)
    value.x.array[:] = -0.01
    dofs = fem.locate_dofs_topological((case.V.sub(1), collapsed), 1, case.facets.find(TOP))
    zero = default_scalar_type(0)
    side = fem.locate_dofs_topological(case.V.sub(0), 1, case.facets.find(LEFT))
    bcs = [
        case.bc(BOTTOM),
        fem.dirichletbc(value, dofs, case.V.sub(1)),
        fem.dirichletbc(zero, side, case.V.sub(0)),
    ]
    assert dm.newton(case.problem(bcs=bcs)).converged


@pytest.mark.parametrize(
    "loads", ["bilinear", "functional", "other space", "number", "Function", "compiled"]
)
def test_loads(case, loads):
    v, w = ufl.TestFunction(case.V), ufl.TrialFunction(case.V)
    form = {
        "bilinear": ufl.inner(v, w) * ufl.dx,
        "functional": case.u[0] * ufl.dx,
        "other space": ufl.TestFunction(PressedBlocks().V)[0] * ufl.dx,
        "number": 0.0,
        "Function": case.u,
        "compiled": fem.form(v[0] * ufl.dx),
    }[loads]
    hint = {"other space": "test function", "compiled": "UFL"}.get(loads, "linear form")
    with rejected("loads", hint) as caught:
        case.problem(loads=form)
    assert len(str(caught.value)) < 150  # no page of UFL


# -- Dirichlet conditions that contradict each other, or are on no dofs


@pytest.mark.mpi
def test_two_values_of_one_node(case):
    """At once, and in the step in which they part; in the corners, which two sides share."""
    side = fem.Constant(case.mesh, default_scalar_type((0.0, -0.02)))
    with rejected("bcs", " and -0.02 for V.sub(1) at (0, ", "one of them"):
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
        with rejected("bcs", "0.001 and 0 for V.sub(1) at ("):
            case.problem(bcs=[case.bc(BOTTOM), *bcs])
    else:
        case.problem(bcs=[case.bc(BOTTOM), *bcs])


@pytest.mark.mpi
@pytest.mark.parametrize("dof", [-1, 10**6, 2**31 - 1])
@pytest.mark.parametrize("component", [None, 0])
def test_dofs_that_are_none(case, dof, component):
    """On one rank only."""
    dofs = some_rank(np.array([dof], dtype=np.int32))
    if component is None:
        bc = fem.dirichletbc(np.zeros(2), dofs, case.V)
    else:
        bc = fem.dirichletbc(0.0, dofs, case.V.sub(component))
    with rejected("bcs holds a condition on the dof", "this rank has 0 to", "locate_dofs"):
        case.problem(bcs=[*case.bcs(), bc])


def test_dofs_of_another_component(case):
    """Nodes of V, taken for dofs of a component."""
    dofs = fem.locate_dofs_topological(case.V, 1, case.facets.find(BOTTOM))
    bc = fem.dirichletbc(0.0, dofs, case.V.sub(1))
    with rejected("V.sub(1) at dofs of other components", "locate its dofs on V.sub(1)"):
        case.problem(bcs=[bc])


@pytest.mark.mpi
@pytest.mark.parametrize("entity", [-1, 10**6, -(2**31)])
def test_tags_of_entities_that_are_none(case, entity):
    """On one rank only."""
    own = some_rank(np.array([entity], dtype=np.int32))
    for dim, tags, of in (
        (1, case.facets, lambda tags: case.problem([case.contact(facets=tags)])),
        (2, case.cells, lambda tags: dm.Solid(case.u, {1: ELASTIC, 2: ELASTIC}, tags)),
    ):
        entities = np.sort(np.concatenate([tags.indices, own])).astype(np.int32)
        values = np.full(len(entities), TOP_OF_LOWER, dtype=np.int32)
        with rejected("tags mark the entity", f"of dimension {dim}", "this rank has 0 to"):
            of(mesh.meshtags(case.mesh, dim, entities, values))


# -- complex and single precision


def test_complex_values(case):
    """In a build for real numbers: numpy's would lose the imaginary part, or dolfinx refuse."""
    value = fem.Constant(case.mesh, np.array([0.0, 1j]))
    number = fem.Constant(case.mesh, np.array(1j))
    v, dofs = ufl.TestFunction(case.V), np.arange(1, dtype=np.int32)
    bc, tie = fem.dirichletbc(value, dofs, case.V), {"slave": TOP_OF_LOWER, "master": TOP}
    for call, name in (
        (lambda: case.problem(bcs=[bc]), "bcs holds"),
        (lambda: case.problem(loads=ufl.inner(value, v) * ufl.dx), "loads holds"),
        (lambda: case.problem(potential=number * case.u[0] ** 2 * ufl.dx), "potential holds"),
        (lambda: dm.Solid(case.u, dm.Elastic(number, 0.3)), "Elastic: E holds"),
        (lambda: dm.Solid(case.u, ELASTIC, eigenstrain=number), "eigenstrain holds"),
        (lambda: dm.Solid(fem.Function(case.V, dtype=np.complex128), ELASTIC), "u holds"),
        (lambda: dm.Tie(case.facets, **tie, jump=value), "jump holds"),
    ):
        with rejected(name, "real", "float64"):
            call()
    for jump in ((0.0, 1j), np.array([0.0, 1j]), (True, False), ("0", "1"), (0, 10**400)):
        with rejected("jump is", "give 2 Cartesian components"):
            dm.Tie(case.facets, **tie, jump=jump)
    with rejected("holds a ufl.Coefficient", "dolfinx.fem"):
        case.problem(loads=ufl.inner(ufl.Coefficient(case.V), v) * ufl.dx)


def test_mesh_in_single_precision():
    domain = mesh.create_unit_square(COMM, 2, 2, dtype=np.float32)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    with rejected("u holds a Function of type float32", "float64"):
        dm.Solid(fem.Function(V, dtype=np.float32), ELASTIC)
    facets = mesh.meshtags(domain, 1, np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    with rejected("coordinates of the mesh are of type float32", "dtype=numpy.float64"):
        dm.assemble_mortar(V, facets, slave=1, master=2)


# -- numbers that are none


@pytest.mark.mpi
def test_nan_in_the_loads_of_one_rank(case):
    force = fem.Function(case.V)
    force.x.array[some_rank(np.arange(len(force.x.array)))[:1]] = np.nan
    problem = case.problem(loads=ufl.inner(force, ufl.TestFunction(case.V)) * ufl.dx)
    with rejected("loads", "NaN", "coefficients"):
        dm.newton(problem)
    force.x.array[:] = 0.0
    assert dm.newton(problem).converged


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_in_boundary_values(case, value):
    problem = case.problem()
    case.top.value[:] = (0.0, value)
    with rejected("bcs", "NaN", "check the values"):
        dm.newton(problem)
    assert not case.u.x.array.any()


@pytest.mark.mpi
def test_nan_in_boundary_values_of_one_rank(case):
    value = fem.Function(case.V)
    dofs = fem.locate_dofs_topological(case.V, 1, case.facets.find(TOP))
    owned = dofs[dofs < case.V.dofmap.index_map.size_local]
    value.x.array[2 * some_rank(owned)[:1]] = np.nan
    problem = case.problem(bcs=[case.bc(BOTTOM), fem.dirichletbc(value, dofs)])
    with rejected("bcs: 1 values", "check the values"):
        dm.newton(problem)


@pytest.mark.mpi
def test_nan_in_the_start(case):
    problem = case.problem()
    case.u.x.array[some_rank(np.arange(len(case.u.x.array)))[:1]] = np.nan
    with rejected("u:", "finite displacement"):
        dm.newton(problem)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_in_a_potential(case, value):
    """In the audit, and in a later step."""
    stiffness = fem.Constant(case.mesh, value)
    problem = case.problem(potential=stiffness * (1.0 + case.u[0]) ** 2 * ufl.dx)
    for call in (problem.audit, lambda: dm.newton(problem)):
        with rejected(f"potential is {value}", "check its coefficients"):
            call()
        stiffness.value = 1.0
        assert dm.newton(problem).converged
        stiffness.value = value


@pytest.mark.mpi
@pytest.mark.parametrize("when", ["before", "after"])
def test_nan_in_coordinates(case, when):
    """One point far from the interface, before or after the problem is made."""
    problem = case.problem() if when == "after" else None
    x = case.mesh.geometry.x
    x[np.isclose(x[:, 1], -1.0) & np.isclose(x[:, 0], 0.0), 0] = np.nan
    with rejected("coordinates", "check the mesh"):
        dm.newton(case.problem() if problem is None else problem)


@pytest.mark.mpi
def test_nan_in_interface_coordinates(case):
    x = case.mesh.geometry.x
    x[np.isclose(x[:, 1], 0.0) & np.isclose(x[:, 0], 0.0), 0] = np.nan
    with rejected("coordinates", "finite"):
        dm.assemble_mortar(case.V, case.facets, slave=3, master=4)


@pytest.mark.parametrize(
    ("times", "word"), [([0.5, np.nan], "finite"), ([np.inf], "finite"), (1.0, "[1.0]")]
)
def test_times(case, times, word):
    with rejected("times", word):
        next(dm.load_steps(case.problem(), times))
