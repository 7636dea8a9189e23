# SPDX-License-Identifier: MIT
"""Derivatives of converged steps: Hertz' closed ones, and differences of whole solutions."""

from functools import partial

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from tests.cases.friction import PLANE, SPACE
from tests.cases.pressed_blocks import rejected
from tests.cases.two_bodies import TwoBodies
from tests.choice import quick
from tests.tool_case import AXIS, BALL, BASE, COMM, DISC, NU, SIDE, TOP, Block, Body, E, R, mark

PRESS = 0.06


def constants(domain, *values):
    return [fem.Constant(domain, value) for value in values]


def pressed(law=dm.Elastic, more=(), cell="triangle", **options):
    """Return a problem below a disc or ball, the tool, and Constants: E, nu and others."""
    case = Block(n=12, fine=0.6, cell=cell)
    E_, nu, *others = constants(case.mesh, E, NU, *more)
    tool = case.tool(BALL if "kinematics" in options else DISC)
    problem = case.problem([tool], law=law(E_, nu, *others), **options)
    tool.position.value[1] = R - PRESS
    return problem, tool, [E_, nu, *others]


def elastic(**options):
    problem, tool, to = pressed(**options)
    ways = [(tool.position, np.array([0.0, 1.0])), (tool.shape, "radius")]
    return problem, lambda: tool.force, [*to, *ways]


def plastic(**options):
    problem, tool, to = pressed(dm.VonMises, (0.3, 10.0), **options)
    return problem, lambda: tool.tool_force, to


def field():
    """A modulus that varies, in one direction."""
    case = Block(n=12, fine=0.6)
    modulus = fem.Function(fem.functionspace(case.mesh, ("DG", 0)))
    modulus.x.array[:] = E
    way = fem.Function(modulus.function_space)
    way.interpolate(lambda x: E * np.exp(x[1] / R))
    tool = case.tool(DISC)
    tool.position.value[1] = R - PRESS
    problem = case.problem([tool], law=dm.Elastic(modulus, NU))
    return problem, lambda: tool.moment[2], [(modulus, way)]


def loaded():
    """A traction beside a disc."""
    case = Block(n=12, fine=0.6)
    (t,), tool = constants(case.mesh, 0.3), case.tool(DISC)
    ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)(SIDE)
    load = ufl.inner(t * ufl.Identity(2)[:, 0], ufl.TestFunction(case.V)) * ds
    tool.position.value[1] = R - PRESS
    problem = case.problem([tool], loads=load)
    return problem, lambda: np.append(tool.force, dm.reaction(problem).force), [t]


def slipping(cell="triangle", way=0.003, **options):
    """Blocks of which some nodes slip and others stick."""
    space = cell == "hexahedron"
    case = TwoBodies(cell, **(SPACE if space else PLANE))
    mu, modulus = constants(case.mesh, 0.3, 1000.0)
    contact = case.interface(friction=mu, surface="facets")
    bcs = case.bcs(way, *[0.4 * way] * space, -0.02)
    problem = case.problem([contact], bcs, dm.Elastic(modulus, 0.3), **options)
    e = np.eye(case.d)[0]
    return (
        problem,
        lambda: np.append(contact.force, contact.dissipated),
        [mu, modulus, (case.top, e)],
    )


def tied():
    """Blocks that are tied, sheared."""
    case = TwoBodies("quadrilateral", **PLANE)
    tie = case.interface(dm.Tie)
    problem = case.problem([tie], case.bcs(0.01, 0.02))
    return problem, lambda: tie.force, [(case.top, np.array([0.0, 1.0]))]


def dragged():
    """A disc below which the middle of the surface is moved, where slips are prescribed."""
    case = Block(n=12, fine=0.6)
    mu, way = constants(case.mesh, 0.3, 0.004)
    tool = case.tool(DISC, friction=mu)
    bcs = [case.hold(BASE, 1), case.hold(AXIS, 0, way)]
    tool.position.value[1] = R - PRESS
    return case.problem([tool], bcs=bcs), lambda: tool.force, [mu, way]


CASES = {
    "dragged": dragged,
    "elastic": elastic,
    "reference": lambda: elastic(geometry="reference"),
    "finite": lambda: elastic(strain="finite"),
    "rings": lambda: elastic(kinematics="axisymmetric"),
    "plastic": plastic,
    "plastic, reduced": lambda: plastic(cell="quadrilateral", volumetric="reduced"),
    "plastic, finite": lambda: plastic(strain="finite"),
    "field": field,
    "loaded": loaded,
    "slipping": slipping,
    "slipping wholly": lambda: slipping(way=0.05),
    "slipping in space": lambda: slipping("hexahedron"),
    "tied": tied,
}


def move(p, h):
    thing, way = p if isinstance(p, tuple) else (p, 1.0)
    if isinstance(way, str):
        setattr(thing, way, getattr(thing, way) + h)
    elif isinstance(thing, fem.Function):
        thing.x.array[:] += h * way.x.array
    else:
        thing.value[...] += h * way


def size(p):
    thing = p[0] if isinstance(p, tuple) else p
    return 1.0 if isinstance(thing, fem.Function) else 0.2 if p is not thing else float(thing.value)


def differences(solved, p):
    """Richardson's of central differences."""
    h, found = 2e-4 * size(p), []
    for k in (1, -1, 2, -2):
        move(p, k * h)
        found.append(solved())
        move(p, -k * h)
    a, b, c, d = found
    return (8.0 * (a - b) - (c - d)) / (12.0 * h)


@pytest.mark.mpi
@pytest.mark.parametrize("name", quick(CASES, "elastic", "plastic", "slipping"))
def test_as_differences_of_whole_solutions(name):
    problem, of, to = CASES[name]()

    def solved():
        dm.newton(problem, rtol=1e-12)
        return np.ravel(of())

    solved()
    found = dm.sensitivity(problem, of=[of], to=to)
    assert found.notes == []
    for k, p in enumerate(to):
        expected, mine = differences(solved, p), found.values[0].reshape(-1, len(to))[:, k]
        assert np.abs(mine - expected).max() < 1e-6 * np.abs(expected).max(), k


class HalfSpace(Block):
    """A large cylinder, fine below the contact of radius a."""

    def __init__(self, a, inner=60, outer=50, size=1000.0):
        x = [np.linspace(0.0, 1.2, inner + 1), 1.2 * np.geomspace(1.0, size, outer + 1)[1:]]
        y = [[0.0], np.geomspace(0.01, size, outer)]
        n = [inner + outer, outer]
        domain = mesh.create_rectangle(COMM, [[0.0, 0.0], n], n, mesh.CellType.quadrilateral)
        facets = mark(domain, {BASE: (1, n[1]), SIDE: (0, n[0]), TOP: (1, 0.0), AXIS: (0, 0.0)})
        for i, (at, sign) in enumerate([(x, a), (y, -a)]):
            number = np.rint(domain.geometry.x[:, i]).astype(int)
            domain.geometry.x[:, i] = sign * np.concatenate(at)[number]
        self.turned = np.eye(2)
        Body.__init__(self, domain, facets, 2)


class Ball(dm.shapes.Sphere):
    """A ball that keeps its lowest point when its radius changes."""

    def distance(self, x):
        return dm.shapes.Sphere([0.0, self.radius], self.radius).distance(x)


def test_derivatives_of_hertz():
    """P = 4/3 E / (1 - nu^2) sqrt(R) d^1.5 (Johnson, Contact Mechanics, 1985, eq. 4.23).

    The numbers are those of E = 200e3, nu = 0.3, R = 10 and d = 0.1. Hertz neglects the radial
    motion of the surface, in the force by about a / 6 R, so d is smaller here.
    """
    radius, d, to_d = 10.0, 2e-4, 0.1
    case = HalfSpace(np.sqrt(radius * d))
    modulus, nu = constants(case.mesh, 200e3, 0.3)
    ball = Ball([0.0, radius], radius)
    tool = case.tool(ball)
    problem = case.problem([tool], law=dm.Elastic(modulus, nu), kinematics="axisymmetric")
    tool.position.value[1] -= d
    dm.newton(problem, rtol=1e-7)
    to = [modulus, nu, (ball, "radius"), (tool.position, np.array([0.0, -1.0]))]
    (found,) = dm.sensitivity(problem, of=[lambda: tool.tool_force[1]], to=to).values
    scaled = found * (to_d / d) ** np.array([1.5, 1.5, 1.5, 0.5])
    assert scaled == pytest.approx([0.146520, 19321.3, 1465.20, 439560.0], rel=5e-3)


def press_and_withdraw():
    problem, tool, to = pressed(dm.VonMises, (0.3, 10.0))
    return problem, lambda: tool.force, to, tool.position, (R - 0.04, R - 0.06, R - 0.05), 1


def push_and_pull():
    """Nodes begin to slip, slip on, and stick or slip back."""
    problem, of, to = slipping(geometry="updated")
    return problem, of, to[:2], to[2][0], (0.003, 0.02, 0.018), 0


HISTORIES = {"plastic": press_and_withdraw, "slipping": push_and_pull}


def walk(name, moved=None):
    """Return forces of all steps, and derivatives unless parameter k is moved by a share."""
    problem, of, to, drive, values, axis = HISTORIES[name]()
    if moved is not None:
        move(to[moved[0]], moved[1] * size(to[moved[0]]))
    forces, found = [], []
    for value in values:
        drive.value[axis] = value
        dm.newton(problem, rtol=1e-12)
        forces.append(of())
        if moved is None:
            to = dm.sensitivity(problem, of=[of], to=to)
            found.append(to.values[0])
        problem.commit()
    return np.array(forces), np.array(found)


@pytest.mark.parametrize("name", HISTORIES)
def test_history(name):
    """By all Constants, in three steps."""
    found, h, to = walk(name)[1], 1e-4, HISTORIES[name]()[2]
    for k, p in enumerate(to):
        ends = [walk(name, (k, s * h))[0] for s in (1, -1, 2, -2)]
        expected = (8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12.0 * h * size(p))
        assert np.abs(found[:, :, k] - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.mpi
@pytest.mark.parametrize("name", quick(CASES, "plastic", "slipping"))
def test_nothing_is_changed(name):
    """This step, and the next one, to the last bit; on ranks meshes are not divided alike."""
    ends = []
    for ask in (False, True):
        problem, of, to = CASES[name]()
        dm.newton(problem)
        before, K = state(problem), problem.K.copy()
        if ask:
            dm.sensitivity(problem, of=[of], to=to)
        assert all(map(same, state(problem), before)) and K.equal(problem.K)
        problem.commit()
        move(to[0], 0.01 * size(to[0]))
        dm.newton(problem)
        ends.append(state(problem))
        move(to[0], -0.01 * size(to[0]))
    assert COMM.size > 1 or all(map(same, *ends))


same = partial(np.array_equal, equal_nan=True)


def state(problem):
    fields = [problem.u, problem.solid.stress, *problem.solid.state.values()]
    fields += [f for one in problem.interfaces for f in one.nodal.values()]
    return [f.x.array.copy() for f in fields]


def wavy(h, degree, **options):
    """Return blocks in contact whose sides are moved by h times a wave, a Function."""
    case = TwoBodies("quadrilateral", degree, **PLANE)
    way = fem.Function(case.V)
    on = 0.02, 1e-6
    way.interpolate(
        lambda x: on[0] * np.stack([np.sin(2 * x[0]), np.cos(3 * x[0])]) * (abs(x[1]) < on[1])
    )
    domain = case.mesh.geometry
    nodes = case.V.dofmap.list[:, : domain.dofmap.shape[1]]
    domain.x[domain.dofmap, :2] += h * way.x.array.reshape(-1, 2)[nodes]
    contact = case.interface(surface="facets")
    problem = case.problem([contact], case.bcs(0.003, -0.02), **options)
    dm.newton(problem, rtol=1e-12)
    return problem, contact, way


@pytest.mark.mpi
def test_elastic_bodies_have_no_history():
    """After load steps as in one step, without and with their result."""
    problem, of, to = elastic()
    dm.newton(problem, rtol=1e-10)
    expected = dm.sensitivity(problem, of=[of], to=to).values[0]
    other, of, to = elastic()
    position = to[2][0]
    ramp = {position: [(0.0, (0.0, R)), (1.0, (0.0, R - PRESS))]}
    for _ in dm.load_steps(other, [0.5, 1.0], ramp=ramp, rtol=1e-10, progress=False):
        to = dm.sensitivity(other, of=[of], to=to)
    assert np.abs(to.values[0] - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.mpi
@pytest.mark.parametrize(("degree", "geometry"), [(1, "updated"), (2, "reference")])
def test_coordinates_of_a_side(degree, geometry):
    options = {"degree": degree, "geometry": geometry}
    problem, contact, way = wavy(0.0, **options)
    forms = [0.5 * ufl.inner(problem.u, problem.u) * ufl.dx]
    to = [(problem.V.mesh, way)] * 2
    found = dm.sensitivity(problem, of=[lambda: contact.force, *forms], to=to).values
    assert np.array_equal(found[0][:, 0], found[0][:, 1])
    ends, h = [], 1e-3
    for s in (1, -1, 2, -2):
        other, moved, _ = wavy(s * h, **options)
        form = fem.form(0.5 * ufl.inner(other.u, other.u) * ufl.dx)
        energy = COMM.allreduce(fem.assemble_scalar(form))
        ends.append(np.append(moved.force, energy))
    expected = (8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12.0 * h)
    assert np.abs(found[0][:, 0] - expected[:2]).max() < 1e-6 * np.abs(expected[:2]).max()
    assert found[1][:1] == pytest.approx(expected[2:], rel=1e-6)


def test_nodes_at_the_limit_are_named():
    """Where the sixth node closes, found by bisection."""
    problem, tool, to = pressed()
    ends = [0.05, 0.055]
    while ends[1] - ends[0] > 1e-7:
        depth = sum(ends) / 2
        tool.position.value[1] = R - depth
        dm.newton(problem, rtol=1e-9)
        ends[int(tool.active.x.array.sum()) == 6] = depth
    notes = dm.sensitivity(problem, of=[lambda: tool.force], to=to).notes
    assert len(notes) == 1 and "1 nodes are about to open or close" in notes[0]


def wrong(case):
    """Return a problem that has made a step, and what is asked of it."""
    problem, of, to = (elastic if "elastic" in case else plastic)()
    if "before" not in case:
        dm.newton(problem)
    asked = {"of": [of], "to": to}
    if "since" in case:
        move(to[0], 1.0)
    if "committed" in case:
        problem.commit()
    if "later" in case:
        dm.newton(problem)
    if "stale" in case:
        dm.newton(problem)
        asked["to"] = dm.sensitivity(problem, of=[of], to=to)
        problem.commit()
        move(to[0], 1.0)
        dm.newton(problem)
        problem.commit()
        dm.newton(problem)
    return problem, asked


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("elastic, before", ["no converged step", "newton(problem)"]),
        ("elastic, changed since", ["does not solve it", "newton()"]),
        ("plastic, committed", ["history", "before commit()"]),
        ("plastic, committed, later", ["the result of the last one"]),
        ("plastic, stale", ["another step than the last one"]),
    ],
)
def test_no_derivatives_in_words(case, words):
    problem, asked = wrong(case)
    with rejected(*words):
        dm.sensitivity(problem, **asked)


@pytest.mark.mpi
def test_wrong_arguments_in_words():
    problem, of, to = elastic()
    dm.newton(problem)
    (other,) = constants(problem.V.mesh, 1.0)
    for asked, words in (
        ({"of": of}, ["of is", "give a list"]),
        ({"of": [ufl.TestFunction(problem.V)[0] * ufl.dx]}, ["of[0]", "functional"]),
        ({"to": other}, ["to is", "give a list"]),
        ({"to": [other]}, ["nothing reads"]),
        ({"to": [to[0], "E"]}, ["to[1]", "Constant"]),
        ({"to": [(DISC, "colour")]}, ["to[0]", "object, name"]),
        ({"to": [(to[2][0], np.zeros(2))]}, ["to[0]", "shape (2,)", "not zero"]),
        ({"to": []}, ["to is []", "give a list"]),
    ):
        with rejected(*words):
            dm.sensitivity(problem, **{"of": [of], "to": to} | asked)


def test_loads_of_tools_are_left_out():
    case = Block(n=12, fine=0.6)
    tool = case.tool(DISC, load={"y": -1.0})
    problem = case.problem([tool])
    dm.newton(problem)
    with rejected("loads drive a tool"):
        dm.sensitivity(problem, of=[lambda: 0.0], to=[tool.position])
