# SPDX-License-Identifier: MIT
"""Arguments that differ between ranks: an error on all ranks before a collective call."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.cases.pressed_blocks import COMM, ELASTIC, Bare, PressedBlocks, rejected

pytestmark = pytest.mark.mpi
LAST = COMM.size - 1
HERE = COMM.rank == LAST > 0  # the rank that gives something else; on one rank there is none
SIDES = {"slave": TOP_OF_LOWER, "master": BOTTOM_OF_UPPER}


@pytest.fixture
def case():
    return PressedBlocks()


def constant(case, value):
    return fem.Constant(case.mesh, value)


def refused(name, make):
    """Expect the error that names the argument and the last rank; none on one rank."""
    if COMM.size == 1:
        make()
        return
    with rejected(f"{name} differs between the ranks: ", f"on rank {LAST}", "all ranks the same"):
        make()


def work(case, force, measure=ufl.dx):
    return ufl.inner(force, ufl.TestFunction(case.V)) * measure(case.mesh)


@dataclass(frozen=True)
class Unnamed(dm.Elastic):
    """A law that does not tell what it is."""

    def __getattribute__(self, name):
        if HERE and name == "E":
            raise KeyError(name)
        return super().__getattribute__(name)


def materials(law):
    return lambda c: dm.Solid(c.u, law(c), c.cells)


def solid(**given):
    return lambda c: dm.Solid(c.u, ELASTIC, **({"cell_tags": c.cells} | given))


def problem(**given):
    return lambda c: c.problem([], **given)


def contact(**given):
    return lambda c: c.problem([dm.Contact(c.facets, **(SIDES | given))])


def finite(c):
    return dm.Solid(c.u, dm.NeoHooke(1000.0, 0.3), strain="finite")


def pressure(**given):
    def make(c):
        dm.Pressure(**({"solid": finite(c), "facet_tags": c.facets, "tag": TOP, "p": 1.0} | given))

    return make


def newton(**given):
    return lambda c: dm.newton(c.problem(), **given)


def obstacle(c):
    """What functions of a user are is told by their values at the side."""
    shape = dm.shapes.SignedDistance(lambda x: x[1] - 1.5 + 0.01 * HERE, (0.0, 2.0), length=1.0)
    c.problem([dm.Obstacle(c.facets, slave=TOP_OF_LOWER, shape=shape)])


def anew(**given):
    """Return a step of a tie that is given other values after its problem is made."""

    def make(c):
        tie = c.tie()
        tied = c.problem([tie])
        for name, value in given.items():
            setattr(tie, name, value)
        dm.newton(tied)

    return make


def walked(**given):
    return lambda c: next(dm.load_steps(c.problem(), **{"times": [1.0]} | given))


def mortar(call, name, other):
    """Return a call in which a rank has another argument."""

    def make(c):
        own = {"V": c.V, "facet_tags": c.facets, "u": c.u} | SIDES
        call(**own | ({name: other} if HERE else {}))

    return make


NODE = (0.0, -1.0)
DIFFERENT = [
    ("materials.E", materials(lambda c: dm.Elastic(2000.0 if HERE else 1000.0, 0.3))),
    ("materials[2].E", materials(lambda c: {1: ELASTIC, 2: dm.Elastic(1e3 + HERE, 0.3)})),
    ("materials", materials(lambda c: object.__new__(Unnamed))),
    ("cell_tags", lambda c: dm.Solid(c.u, ELASTIC, None if HERE else c.cells)),
    (
        "cell_tags.names['a']",
        lambda c: dm.Solid(c.u, ELASTIC, dm.Tags(c.cells, {"a": 1 + HERE})),
    ),
    ("quadrature_degree", solid(quadrature_degree="2" if HERE else 2)),
    ("eigenstrain[2]", solid(eigenstrain={1: 0.0, 2: [0.0] if HERE else 0.0})),
    ("bcs[0]: value", lambda c: c.problem(bcs=[c.bc(BOTTOM, (0.0, 0.01 * HERE))])),
    ("loads", lambda c: c.problem(loads=work(c, ufl.as_vector([0.0, -1.0 - HERE])))),
    ("potential", lambda c: c.problem(potential=(1.0 + HERE) * ufl.inner(c.u, c.u) * ufl.dx)),
    ("petsc_options['pc_type']", problem(petsc_options={"pc_type": "lu" if HERE else "qr"})),
    ("geometry", problem(geometry="reference" if HERE else "updated")),
    ("interfaces", lambda c: c.problem([] if HERE else [c.contact()])),
    ("interfaces[0].friction", contact(friction=0.3 + 1e-9 * HERE)),  # less than its text shows
    (
        "residual",
        lambda c: dm.WeakForm(
            finite(c), residual=5.0 if HERE else ufl.inner(c.u, ufl.TestFunction(c.V)) * ufl.dx
        ),
    ),
    ("closed", pressure(closed=not HERE)),
    ("terms[0]['linear']", lambda c: c.problem(terms=[Bare(linear=HERE)])),
    (
        "terms[0]['state'][0]",
        lambda c: c.problem(terms=[Bare(state={"ab"[HERE]: fem.Function(c.V)})]),
    ),
    # also if the value of one rank is wrong in itself: that rank would leave the others alone
    ("rtol", newton(rtol=-1.0 if HERE else 1e-6)),
    ("qp", newton(qp="no backend" if HERE else "active-set")),
    ("times", walked(times=[1.0, 2.0][HERE:])),
    ("max_cuts", walked(max_cuts=int(HERE))),
    (
        "ramp[0][1][1][1][1]",
        lambda c: walked(ramp={c.top: [(0.0, (0.0, 0.0)), (1.0, (0.0, -0.01 - HERE))]})(c),
    ),
    ("within", lambda c: c.problem([c.tie(within=1.0 + HERE)])),
    ("jump", anew(jump=None if HERE else [0.0, 1e-3])),
    ("interfaces[0].pretension", anew(pretension=30.0 + HERE)),
    ("interfaces[0].direction[0]", anew(pretension=30.0, direction=[0.1 * HERE, -1.0])),
    ("interfaces[0].distances[1]", obstacle),
    ("point[0]", lambda c: dm.PointForce(c.V, (1.0 * HERE, -1.0), (0.0, 1.0))),
    ("stiffness", lambda c: dm.PointSpring(c.V, NODE, 1.0 + HERE)),
    *(
        (name, mortar(call, name, other))
        for call in (dm.segments, dm.assemble_mortar)
        for name, other in (("slave", TOP), ("master", TOP), ("u", None), ("facet_tags", None))
    ),
]


@pytest.mark.skipif(COMM.size == 1, reason="one rank agrees with itself")
@pytest.mark.parametrize(("name", "make"), DIFFERENT)
def test_what_differs_is_named(case, name, make):
    refused(name, lambda: make(case))
    assert not case.u.x.array.any()


def test_constants_that_differ_at_a_step(case):
    """Nothing has moved then; with the same values the step is made."""
    E, heat, mu, k = (constant(case, v) for v in (1000.0, 0.0, 0.1, 1.0))
    pull = constant(case, (0.0, 0.0))
    side = dm.Contact(case.facets, **SIDES, friction=mu)
    body = dm.Solid(case.u, dm.Elastic(E, 0.3), eigenstrain=heat)
    potential = 0.5 * k * ufl.inner(case.u, case.u) * ufl.ds
    forms = {"loads": work(case, pull), "potential": potential}
    whole = case.problem([side], law=body, **forms)
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
            refused(name, lambda: dm.newton(whole))
            assert not case.u.x.array.any()
        value.value = kept
    assert dm.newton(whole).converged
    whole.commit()

    def on_time(t):
        case.top.value[1] = -0.01 - 0.001 * t * HERE

    walk = dm.load_steps(whole, [1.0], on_time=on_time)
    refused("bcs[1]: value", lambda: list(walk))
    alone = dm.load_steps(whole, [1.0], on_time=on_time if HERE else None)
    if COMM.size > 1:
        refused("on_time", lambda: list(alone))


def test_arguments_of_pictures_and_writers(case, folder):
    """The name of a field decides what is gathered; ranks that resume read together."""
    path, pressed = folder / "out.xdmf", case.problem()
    dm.newton(pressed)
    if COMM.size > 1:
        name = "nothing" if HERE else "von_mises"
        refused("name", lambda: dm.plotting.field(pressed, name, file=path.with_suffix(".png")))
        refused("path", lambda: dm.Writer(path.with_name(f"{HERE}.xdmf"), pressed))
        refused("resume", lambda: dm.Writer(path, pressed, resume=HERE))


class Silent:
    """A communicator on which nothing but one reduction is allowed."""

    size = 2  # so that there is something to compare
    sent = 0

    def Allreduce(self, _, values, op):
        self.sent += values.nbytes
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
        "times": (1, np.nan) if HERE else np.array([1.0, np.nan]),
        "contact": case.contact(),
    }
    silent = Silent()
    check_same_on_all_ranks(silent, **values)
    assert silent.sent == 16


def test_many_ranks_and_long_values_make_no_long_message():
    """What is shown is the first entry that differs, of the first rank."""

    class Many(Silent):
        def Allreduce(self, _, values, op):
            values[:] = 1, 1  # no two numbers that one digest could give

        def allgather(self, texts):
            return [texts, *[texts | {"name[499]": "500.0"}] * 999]

    with rejected("name[499] differs ", ": 499.0 on rank 0, but 500.0 on rank 1") as caught:
        check_same_on_all_ranks(Many(), name=[float(k) for k in range(500)])
    assert len(str(caught.value)) < 500
