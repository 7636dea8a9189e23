# SPDX-License-Identifier: MIT
"""Loads and the potential: closed-form answers, and derivatives against finite differences."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import COMM, create_displacement, hold, plane, rectangle, rollers, tag_facets
from tests.cases.two_bodies import create_problem

pytestmark = pytest.mark.mpi


def create_box(d):
    """Return a displacement on a box of height 1 (the last direction), and its facets' measure."""
    u = create_displacement(rectangle([d * [0.0], [2.0, *(d - 2) * [1.5], 1.0]], (4, 3, 3)[:d]))
    tags = tag_facets(u.function_space.mesh, plane(d - 1), plane(d - 1, 1.0))
    return u, ufl.Measure("ds", u.function_space.mesh, subdomain_data=tags)


def at(u, height):
    d = len(u)
    dofs = hold(u.function_space, plane(d - 1, height), d - 1).dof_indices()[0]
    return u.x.array[dofs]


@pytest.mark.parametrize("d", [2, 3])
def test_spring_bed(d):
    """Pressed by 0.01 on springs as stiff as itself it has half of it, and by a traction p/k."""
    u, ds = create_box(d)
    V = u.function_space
    q = fem.Constant(V.mesh, default_scalar_type(0.0))
    law, bcs = dm.Elastic(1000.0, 0.0), rollers(V, range(d - 1))
    options = {
        "potential": 0.5 * 1000.0 * u[d - 1] ** 2 * ds(1),
        "loads": -q * ufl.TestFunction(V)[d - 1] * ds(2),
    }
    held = [*bcs, hold(V, plane(d - 1, 1.0), d - 1, -0.01)]
    pressed = create_problem(u, (), held, law, **options)
    for _ in range(2):  # a second solve finds the same
        assert dm.newton(pressed, rtol=1e-12).newton_iterations <= 2
        assert np.allclose(at(u, 0.0), -0.005, rtol=1e-12)
        ((_, _), (_, bed)) = pressed.terms.named
        stored = 0.5 * 1000.0 * 0.005**2 * (2.0 if d == 2 else 3.0)
        assert COMM.allreduce(np.sum(bed.energy())) == pytest.approx(stored, rel=1e-11)
        pressed.commit()
    loaded, q.value = create_problem(u, (), bcs, law, **options), 5.0  # read at every assembly
    dm.newton(loaded, rtol=1e-12)
    for height, sinks in ((0.0, 0.005), (1.0, 0.01)):
        assert np.allclose(at(u, height), -sinks, rtol=1e-11)


def refused(forms):
    """Return the arguments of a problem that is refused, of u, v, ds and the space."""

    def make():
        u, ds = create_box(2)
        V = u.function_space
        create_problem(u, **forms(u, ufl.TestFunction(V), ds))

    return make


def of_potential(form):
    return refused(lambda u, v, ds: {"potential": form(u, v, ds)})


def of_loads(inside):
    return refused(lambda u, v, ds: {"loads": -inside(u) * v[1] * ds(1)})


def other(u):
    return fem.Function(u.function_space)


REFUSED = [
    *(
        (of_loads(f), ("loads contain the displacement ", "potential=..."))
        for f in (
            lambda u: u[1],
            lambda u: u.sub(1),
            lambda u: ufl.grad(u)[0, 1],
        )
    ),
    (of_potential(lambda u, v, ds: 3.0), ("potential", "is a float")),
    (of_potential(lambda u, v, ds: u[0] + u[1]), ("potential", "is a Sum")),
    (of_potential(lambda u, v, ds: fem.form(u[0] ** 2 * ds)), ("potential", "compiled form")),
    (of_potential(lambda u, v, ds: ufl.inner(u, v) * ds), ("potential", "has 1 test")),
    (of_potential(lambda u, v, ds: ufl.jump(u)[0] ** 2 * ufl.dS), ("interior_facet",)),
    (of_potential(lambda u, v, ds: create_box(2)[0][0] ** 2 * ufl.dx), ("another mesh",)),
    (of_potential(lambda u, v, ds: other(u)[0] ** 2 * ds), ("potential", "does not contain")),
    (of_potential(lambda u, v, ds: u.sub(1) ** 2 * ds), ("write u[i]",)),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_forms_that_cannot_work_are_refused(call, words):
    with rejected(*words):
        call()


def test_loads_may_contain_another_function():
    refused(lambda u, v, ds: {"loads": other(u)[1] * v[1] * ds(1)})()


def test_a_one_sided_bed_lets_go():
    """Springs that only push: pulled away, the block is free of them; pressed, they take half."""
    u, ds = create_box(2)
    V = u.function_space
    move = fem.Constant(V.mesh, default_scalar_type(0.0))
    bcs = [hold(V, plane(1, 1.0), 1, move), *rollers(V, [0])]
    energy = 0.5 * 1000.0 * ufl.min_value(u[1], 0.0) ** 2 * ds(1)
    problem = create_problem(u, (), bcs, dm.Elastic(1000.0, 0.0), potential=energy)
    assert not problem.terms.linear
    for value, expected in ((-0.01, -0.005), (0.01, 0.01), (-0.02, -0.01)):
        move.value = value
        dm.newton(problem)
        problem.commit()
        assert np.allclose(at(u, 0.0), expected, rtol=1e-6)
