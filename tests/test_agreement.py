# SPDX-License-Identifier: MIT
"""Arguments that differ between ranks: an error on all ranks before a collective call.

Without it the answer is that of a mixture of problems, or there is none.
"""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.agreement import check_same_on_all_ranks
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.cases.pressed_blocks import COMM, ELASTIC, PressedBlocks, rejected

pytestmark = pytest.mark.mpi
LAST = COMM.size - 1
HERE = COMM.rank == LAST > 0  # the rank that gives something else; on one rank there is none


@pytest.fixture
def case():
    return PressedBlocks()


def constant(case, *value):
    return fem.Constant(case.mesh, default_scalar_type(value if len(value) > 1 else value[0]))


def refused(name, make):
    """Expect the error that names the argument and the last rank; none on one rank."""
    if COMM.size == 1:
        make()
        return
    with rejected(f"{name} differs between the ranks: ", f"on rank {LAST}", "all ranks the same"):
        make()


# -- arguments


SOLIDS = {
    "materials.E": lambda c: {"materials": dm.Elastic(2000.0 if HERE else 1000.0, 0.3)},
    "materials": lambda c: {"materials": dm.VonMises(1e3, 0.3, 5.0, 1e1) if HERE else ELASTIC},
    "materials.nu": lambda c: {"materials": dm.Elastic(1e3, constant(c, 0.3) if HERE else 0.3)},
    "materials[2].E": lambda c: {"materials": {1: ELASTIC, 2: dm.Elastic(1e3 + HERE, 0.3)}},
    "materials by tag": lambda c: {"materials": {1: ELASTIC, 3 - HERE: ELASTIC}},
    "cell_tags": lambda c: {"cell_tags": None if HERE else c.cells},
    "cell_tags.names['a']": lambda c: {"cell_tags": dm.Tags(c.cells, {"a": 1 + HERE})},
    "quadrature_degree": lambda c: {"quadrature_degree": "2" if HERE else 2},
    "kinematics": lambda c: {"kinematics": "plane_stress" if HERE else None},
    "eigenstrain": lambda c: {"eigenstrain": 1e-3 * (1 + HERE)},
    "eigenstrain: Constant 1": lambda c: {"eigenstrain": 2 * constant(c, 1e-3 * (1 + HERE))},
    "eigenstrain[2]": lambda c: {"eigenstrain": {1: 0.0, 2: [0.0] if HERE else 0.0}},
    "volumetric": lambda c: {"volumetric": "reduced" if HERE else "full"},
}


@pytest.mark.parametrize("name", SOLIDS)
def test_arguments_of_a_solid(case, name):
    given = {"materials": ELASTIC, "cell_tags": case.cells} | SOLIDS[name](case)
    if COMM.size > 1:
        refused(name.partition(" by")[0], lambda: dm.Solid(case.u, **given))


def work(case, force, measure=ufl.dx):
    return ufl.inner(force, ufl.TestFunction(case.V)) * measure(case.mesh)


def held(case):
    by_number = case.bc(TOP)  # to find dofs and to create Functions is collective
    by_function = fem.dirichletbc(fem.Function(case.V), np.arange(2, dtype=np.int32))
    return by_function if HERE else by_number


PROBLEMS = {
    "bcs[0]: value": lambda c: {"bcs": [c.bc(BOTTOM, (0.0, 0.01 * HERE))]},
    "bcs[1]": lambda c: {"bcs": [c.bc(BOTTOM), held(c)]},
    "loads": lambda c: {"loads": work(c, ufl.as_vector([0.0, -1.0 - HERE]))},
    "loads: Constant 1": lambda c: {"loads": work(c, constant(c, 0.0, -1.0 - HERE))},
    "loads by measure": lambda c: {"loads": work(c, c.top, ufl.ds if HERE else ufl.dx)},
    "loads by none": lambda c: {"loads": None if HERE else work(c, c.top)},
    "potential": lambda c: {"potential": (1.0 + HERE) * ufl.inner(c.u, c.u) * ufl.dx},
    "petsc_options['pc_type']": lambda c: {"petsc_options": {"pc_type": "lu" if HERE else "qr"}},
    "petsc_options_prefix": lambda c: {"petsc_options_prefix": "b_" if HERE else "a_"},
    "geometry": lambda c: {"geometry": "reference" if HERE else "updated"},
    "interfaces": lambda c: {"interfaces": [] if HERE else [c.contact()]},
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_arguments_of_a_problem(case, name):
    given = PROBLEMS[name](case)
    if COMM.size > 1:
        solid = dm.Solid(case.u, ELASTIC)
        refused(name.partition(" by")[0], lambda: dm.ContactProblem(solid, **given))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("slave", {"slave": BOTTOM_OF_UPPER if HERE else TOP_OF_LOWER, "master": 7}),
        ("surface", {"surface": "facets" if HERE else "smooth"}),
        ("feature_angle", {"feature_angle": 40.0 + HERE}),
        ("friction", {"friction": 0.3 + 1e-9 * HERE}),  # less than its text shows
        ("tresca", {"tresca": 1.0} if HERE else {"friction": 1.0}),
    ],
)
def test_arguments_of_a_contact(case, name, options):
    sides = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}
    contact = dm.Contact(case.facets, **(sides | options))
    if COMM.size > 1:
        told = "friction" if name == "tresca" else name  # the first that differs
        refused(f"interfaces[0].{told}", lambda: case.problem([contact]))


def test_a_rank_alone_whose_argument_does_not_tell_what_it_is(case):
    """All ranks learn of it, and none stays behind."""

    @dataclass(frozen=True)
    class Law(dm.Elastic):
        def __getattribute__(self, name):
            if HERE and name == "E":
                raise KeyError(name)
            return super().__getattribute__(name)

    if COMM.size > 1:
        solid = (case.u, object.__new__(Law))
        refused("materials", lambda: dm.Solid(*solid))


# -- what may change between steps


def test_constants_that_differ_at_a_step(case):
    """Nothing has moved then; with the same values the step is made."""
    E, heat, mu, k = (constant(case, v) for v in (1000.0, 0.0, 0.1, 1.0))
    pull = constant(case, 0.0, 0.0)
    contact = dm.Contact(case.facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, friction=mu)
    solid = dm.Solid(case.u, dm.Elastic(E, 0.3), eigenstrain=heat)
    potential = 0.5 * k * ufl.inner(case.u, case.u) * ufl.ds
    forms = {"loads": work(case, pull), "potential": potential}
    problem = dm.ContactProblem(solid, [contact], bcs=case.bcs(), **forms)
    for name, value in {
        "materials.E": E,
        "eigenstrain": heat,
        "interfaces[0].friction": mu,
        "loads: Constant 1": pull,
        "potential: Constant 1": k,
        "bcs[1]: value": case.top,
    }.items():
        kept = value.value.copy()
        value.value = kept + 1e-3 * HERE
        if COMM.size > 1:
            refused(name, lambda: dm.newton(problem))
            assert not case.u.x.array.any()
        value.value = kept
    assert dm.newton(problem).converged
    problem.commit()

    def on_time(t):
        case.top.value[1] = -0.01 - 0.001 * t * HERE

    walk = dm.load_steps(problem, [1.0], on_time=on_time)
    refused("bcs[1]: value", lambda: list(walk))
    alone = dm.load_steps(problem, [1.0], on_time=on_time if HERE else None)
    if COMM.size > 1:
        refused("on_time", lambda: list(alone))


def test_a_jump_that_has_been_set_anew(case):
    """The Constant that a tie had at first counts no more."""
    first = constant(case, 0.0, 0.0)
    tie = dm.Tie(case.facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, jump=first)
    problem = case.problem([tie])
    tie.jump = [0.0, 1e-3]
    first.value[0] = HERE
    assert dm.newton(problem).converged
    tie.tightening = np.array([0.0, 1e-3 * HERE])
    refused("interfaces[0].tightening", lambda: dm.newton(problem))


TERMS = {
    "energy": lambda s: dm.WeakForm(s, energy=(1.0 + HERE) * ufl.inner(s.u, s.u) * ufl.dx),
    "residual": lambda s: dm.WeakForm(
        s, residual=5.0 if HERE else ufl.inner(s.u, ufl.TestFunction(s.V)) * ufl.dx
    ),
    "closed": lambda s: dm.Pressure(s, s.tags, TOP, 1.0, closed=not HERE),
    "p": lambda s: dm.Pressure(s, s.tags, TOP, 1.0 + HERE),
    "tag": lambda s: dm.Pressure(s, s.tags, BOTTOM if HERE else TOP, 1.0),
    "terms[0]['linear']": lambda s: dm.ContactProblem(s, terms=[Bare(linear=HERE)]),
    "terms[0]['state']": lambda s: dm.ContactProblem(
        s, terms=[Bare(state={"ab"[HERE]: fem.Function(s.V)})]
    ),
}


class Bare(dm.Term):
    """Adds nothing."""

    linear, state = False, {}

    def __init__(self, **given):
        """Take some attributes."""
        vars(self).update(given)

    def add_forces(self, F):
        """Do nothing."""

    def add_tangent(self, K):
        """Do nothing."""


@pytest.mark.parametrize("name", TERMS)
def test_arguments_of_terms(case, name):
    solid = dm.Solid(case.u, dm.NeoHooke(1000.0, 0.3), strain="finite")
    solid.tags = case.facets
    if COMM.size > 1:
        refused(name, lambda: TERMS[name](solid))


def test_arguments_of_pictures(case, tmp_path):
    """The name of a field decides what is gathered."""
    problem, file = case.problem(), COMM.bcast(tmp_path) / "picture.png"
    dm.newton(problem)
    name = "nothing" if HERE else "von_mises"
    if COMM.size > 1:
        refused("name", lambda: dm.plotting.field(problem, name, file=file))


def test_a_shape_that_is_another_on_one_rank(case):
    """What functions of a user are is told by their values at the side."""
    shape = dm.shapes.SignedDistance(lambda x: x[1] - 1.5 + 0.01 * HERE, (0.0, 2.0), length=1.0)
    problem = case.problem([dm.Obstacle(case.facets, slave=TOP_OF_LOWER, shape=shape)])
    if COMM.size > 1:
        refused("interfaces[0].distances", lambda: dm.newton(problem))


@pytest.mark.parametrize("name", ["path", "resume"])
def test_arguments_of_a_writer(case, tmp_path, name):
    """Ranks that resume read together what the others do not."""
    path, problem = COMM.bcast(tmp_path) / "out.xdmf", case.problem()
    other = path.with_name("other.xdmf") if HERE and name == "path" else path
    resume = HERE and name == "resume"
    refused(name, lambda: dm.Writer(other, problem, resume=resume).close())


# -- what may differ


class Silent:
    """A communicator on which nothing but one reduction is allowed."""

    size = 2  # so that there is something to compare

    def __init__(self):
        """Nothing is sent yet."""
        self.sent = []

    def Allreduce(self, _, values, op):
        self.sent.append(values.nbytes)
        COMM.Allreduce(MPI.IN_PLACE, values, op=op)


def test_what_belongs_to_the_parts_of_the_mesh_may_differ(case):
    """As well as what else a rank has created, and the order of names; one reduction tells."""
    if HERE:
        [fem.Constant(case.mesh, 0.0) for _ in range(3)]
    f, c = fem.Function(case.V), constant(case, 1.0)
    f.x.array[:] = COMM.rank
    values = {
        "u": f,
        "loads": work(case, c * f),
        "eigenstrain": c * f[0],
        "bcs": [case.bc(BOTTOM), fem.dirichletbc(f, np.arange(HERE, dtype=np.int32))],
        "jump": (lambda x: x) if HERE else (lambda x: 0 * x),
        "names": {"a": 1, "b": -0.0} if HERE else {"b": 0.0, "a": 1},
        "times": (1, 2) if HERE else np.array([1.0, 2.0]),
        "law": ELASTIC,
        "contact": case.contact(),
    }
    silent = Silent()
    check_same_on_all_ranks(silent, **values)
    assert silent.sent == [16]


def test_many_ranks_and_long_values_make_no_long_message():
    """What is shown is where texts begin to differ."""

    class Many(Silent):
        def Allreduce(self, _, values, op):
            values[:] = 1, 1  # no two numbers that one digest could give

        def allgather(self, texts):
            other = {"name": texts["name"].replace("499.0", "500.0")}
            return [texts, *[other] * 999]

    with rejected("... ", "499.0] on rank 0", "500.0] on rank 3 and 996 more") as caught:
        check_same_on_all_ranks(Many(), name=[float(k) for k in range(500)])
    assert len(str(caught.value)) < 500
