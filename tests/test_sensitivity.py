# SPDX-License-Identifier: MIT
"""Derivatives of converged steps: Hertz' closed ones, and differences of whole solutions."""

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


CASES = {
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
    thing, way = p if isinstance(p, tuple) else (p, 1.0)
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
