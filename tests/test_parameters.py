# SPDX-License-Identifier: MIT
"""Parameters of laws that vary in space or change between steps."""

import re
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import basix.ufl
import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, mesh
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import (
    COMM,
    STEEL,
    create_displacement,
    create_domain,
    create_tags,
    largest,
    residual,
    rollers,
    set_wave,
    solid_on,
    total,
)
from tests.cases.user_laws import OfHooke
from tests.choice import quick

pytestmark = pytest.mark.mpi


def constant(domain, value):
    return fem.Constant(domain, default_scalar_type(value))


def function(domain, value, element=("DG", 0)):
    """Return a Function of a value or of x -> values."""
    f = fem.Function(fem.functionspace(domain, element))
    f.interpolate(value if callable(value) else lambda x: np.full(x.shape[1], value))
    f.x.scatter_forward()
    return f


def at_points(domain, value, degree=2):
    element = basix.ufl.quadrature_element(domain.basix_cell(), scheme="default", degree=degree)
    f = fem.Function(fem.functionspace(domain, element))
    f.x.array[:] = value
    return f


KINDS = {
    "Constant": constant,
    "DG0": function,
    "Lagrange": lambda domain, value: function(domain, value, ("Lagrange", 1)),
    "quadrature": at_points,
    "expression": lambda domain, value: 0.5 * value * (1.0 + constant(domain, 1.0)),
    "position": lambda domain, value: value + 0.0 * ufl.SpatialCoordinate(domain)[0],
}


def numbers(solid):
    """Return what a solid says at two displacements with a commit between them."""
    set_wave(solid.u, 2e-3)
    solid.evaluate()
    solid.commit()
    set_wave(solid.u, 2e-3, 0.7)
    K = solid.create_matrix()
    solid.assemble_tangent(K)
    solid.evaluate()
    names = ("von_mises", "back_stress_norm", "plastic_strain_norm")
    found = [total(solid.energy()), K.norm(), np.sqrt(total(residual(solid) ** 2))]
    found += [solid.elastic_norm(solid.u), solid.element_force_norm()]
    return np.array(found + [solid.max(name) for name in names])


@pytest.mark.parametrize("kind", quick(KINDS, "Constant", "quadrature", "expression"))
def test_a_parameter_may_be_whatever_has_the_value(kind):
    """Numbers, Constants, Functions and expressions of equal values make equal solids."""
    domain = create_domain("triangle")
    vary = KINDS[kind]
    law = dm.VonMises(vary(domain, STEEL.E), 0.29, vary(domain, STEEL.Y), STEEL.a)
    varying = solid_on(domain, law, quadrature_degree=2)
    plain = solid_on(domain, STEEL, quadrature_degree=2)
    assert varying.points.follows and not plain.points.follows
    assert numbers(varying) == pytest.approx(numbers(plain), rel=1e-12)


def test_materials_by_tag():
    """Laws follow the tags, of owned cells too: elastic is von Mises that never yields."""
    domain = create_domain("triangle", 6)
    tags = create_tags(domain, lambda x: np.where(x[:, 1] < 1.0, 7, np.where(x[:, 0] < 0.5, 2, 30)))
    own = tags.indices < domain.topology.index_map(2).size_local
    owned = mesh.meshtags(domain, 2, tags.indices[own], tags.values[own])
    soft, never = dm.VonMises(50e3, 0.4, 200.0, 0.0), dm.VonMises(100e3, 0.1, 1e9, 1.0)
    laws = {2: soft, 7: STEEL, 30: never}
    other = {30: dm.Elastic(never.E, never.nu), 7: STEEL, 2: soft}
    varying = laws | {
        2: dm.VonMises(50e3, 0.4, function(domain, 200.0, ("Lagrange", 1)), 0.0),
        30: dm.VonMises(constant(domain, 100e3), 0.1, 1e9, 1.0),
    }
    given = ((laws, tags), (other, tags), (laws, owned), (varying, tags))
    solids = [solid_on(domain, *pair) for pair in given]
    assert [len(solid.regions) for solid in solids] == [1, 2, 1, 1]
    found = [numbers(solid) for solid in solids]
    assert found[1:] == pytest.approx(np.array([found[0]] * 3), rel=1e-11)


def norm_of_tangent(solid):
    K = solid.create_matrix()
    solid.assemble_tangent(K)
    return K.norm()


def largest_stress(solid):
    solid.evaluate()
    return solid.max("von_mises")


ASKED = {
    "residual": lambda s: np.sqrt(total(residual(s) ** 2)),
    "tangent": norm_of_tangent,
    "energy": lambda s: total(s.energy()),
    "norm": lambda s: s.elastic_norm(s.u) ** 2,
    "element": lambda s: s.element_force_norm(),
    "stress": largest_stress,
}


@pytest.mark.parametrize("what", ASKED)
def test_whatever_comes_next_follows_a_change(what):
    """Elastic answers double with E, whichever is asked for first; one dilatation per cell, too."""
    domain, ask = create_domain("quadrilateral"), ASKED[what]
    E = function(domain, 1000.0, ("Lagrange", 1))
    for volumetric in ("full", "reduced"):
        law = dm.Elastic(E, 0.3)
        solid = solid_on(domain, law, volumetric=volumetric)
        set_wave(solid.u, 1e-3)
        before = ask(solid)
        E.x.array[:] *= 2.0
        assert ask(solid) == pytest.approx(2.0 * before, rel=1e-12)


def test_a_linear_law_with_a_constant_has_no_constant_tangent():
    """Half the stiffness between two steps under a body force: twice the displacement, at once."""
    domain = create_domain("triangle")
    u, E = create_displacement(domain), constant(domain, 1000.0)
    solid = dm.Solid(u, dm.Elastic(E, 0.3))
    assert solid.points.follows
    assert not dm.Solid(u, dm.Elastic(1000.0, 0.3)).points.follows
    loads = ufl.TestFunction(u.function_space)[1] * ufl.dx
    problem = dm.ContactProblem(solid, bcs=rollers(u.function_space), loads=loads)
    reports, sizes = [], []
    for value in (1000.0, 500.0, 2000.0):
        E.value = value
        reports.append(dm.newton(problem))
        problem.commit()
        sizes.append(largest(u.x.array))
    assert np.array(sizes) / sizes[0] == pytest.approx([1.0, 2.0, 0.5], rel=1e-8)
    assert all(report.newton_iterations == 1 for report in reports)


def test_output_sees_the_parameters_of_its_points():
    """The back stress is a ep with the a of the point."""
    domain = create_domain("quadrilateral")
    a = function(domain, lambda x: 100.0 * (1 + x[0]))
    solid = solid_on(domain, dm.VonMises(1000.0, 0.3, 1.0, a))
    set_wave(solid.u, 0.1)
    solid.evaluate()
    values = a.x.array[a.function_space.dofmap.list[: len(solid.fields.weights)]]
    expected = values[..., None] * solid.fields.values("plastic_strain")
    assert solid.fields.values("back_stress") == pytest.approx(expected, rel=1e-12)
    assert np.ptp(COMM.allreduce(values.tolist())) > 50.0


def test_values_out_of_range_are_counted_and_placed():
    """How many cells on all ranks, where, and which values."""
    domain = create_domain("triangle")  # 4 x 5 x 2 cells
    E = function(domain, lambda x: np.where(x[0] < 0.5, 1000.0, -x[1]))
    with rejected("Elastic: E in (0.0, inf) does not hold in 20 cells") as caught:
        solid_on(domain, dm.Elastic(E, 0.3))
    low, high = map(float, re.findall(r"E is (\S+) to (\S+)\.", str(caught.value))[0])
    assert -2.0 < low < -1.8 and -0.2 < high < 0.0
    x, y = map(float, re.findall(r"around \((\S+), (\S+)\)", str(caught.value))[0])
    assert 0.5 < x < 1.0 and 0.0 < y < 2.0
    E.x.array[:] = np.nan
    with rejected("does not hold in 40 cells", "E is NaN"):
        solid_on(domain, dm.Elastic(E, 0.3))


def test_a_change_out_of_range_is_refused_until_it_is_undone():
    """What was computed with is kept; every call says so, and all goes on when it is mended."""
    domain = create_domain("triangle")
    nu = function(domain, 0.3, ("Lagrange", 1))
    solid = solid_on(domain, dm.Elastic(1000.0, nu))
    set_wave(solid.u, 1e-3)
    before = solid.energy()
    solid.evaluate()
    stress = solid.stress.x.array.copy()
    nu.x.array[:] = 0.5
    for ask in (solid.energy, solid.evaluate, solid.energy):
        with rejected("nu in (-1.0, 0.5) does not hold in 40 cells"):
            ask()
    assert np.array_equal(solid.stress.x.array, stress)
    nu.x.array[:] = 0.3
    assert solid.energy() == before


class Bounded(OfHooke):
    """Hooke's law of a user, with ranges and a rule for two parameters."""

    linear: ClassVar = True
    ranges: ClassVar = {"E": (1.0, 10.0, True)}
    energy = staticmethod(dm.Elastic.energy)

    @staticmethod
    def conditions(p):
        return {"E * nu < 2": p.E * p.nu < 2}


@pytest.mark.parametrize(
    ("E", "words"),
    [
        (0.5, ("Bounded: E in [1.0, 10.0) does not hold in 40 cells", "E is 0.5 to 0.5")),
        (8.0, ("Bounded: E * nu < 2 does not hold in 40 cells", "E is 8 to 8, nu is 0.3 to 0.3")),
    ],
)
def test_ranges_and_rules_of_a_users_law(E, words):
    domain = create_domain("triangle")
    solid_on(domain, Bounded(6.0, 0.3))
    for law in (Bounded(E, 0.3), Bounded(constant(domain, E), 0.3)):
        with rejected(*words):
            solid_on(domain, law)


@pytest.mark.mpi
def test_rules_of_a_law_that_only_some_ranks_have():
    """The largest of no numbers is an error, which must not stop one rank alone; nor any other."""

    @dataclass(frozen=True)
    class Together(Bounded):
        @staticmethod
        def conditions(p):
            if np.max(p.E) > 8.0:
                raise ZeroDivisionError("E is too large")
            return {"E below 4": np.max(p.E) < 4.0}

    domain = create_domain("triangle")
    u = create_displacement(domain)
    tags = create_tags(
        domain, lambda x: np.arange(len(x)) < (3 if COMM.rank == COMM.size - 1 else 0)
    )
    rest = {0: dm.Elastic(1.0, 0.3)}
    E = constant(domain, 2.0)
    solid = dm.Solid(u, rest | {1: Together(E, 0.3)}, tags)
    for value, message in (
        (6.0, "Together: E below 4 does not hold in 3 cells"),
        (9.0, "Together.conditions raised ZeroDivisionError: E is too large; it must return"),
    ):
        E.value = value
        with rejected(message):
            solid.energy()
    E.value = 2.0
    assert solid.energy() == 0.0


def test_what_cannot_be_a_parameter():
    domain, other = create_domain("triangle"), create_domain("triangle")
    u = create_displacement(domain)
    vector = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    for E, message in [
        (vector, ": give a number, a scalar"),
        (1.0 + u[0] ** 2, "Elastic: E depends on the displacement"),
        (function(other, 1.0), "Elastic: E lives on another mesh"),
        (at_points(domain, 1.0, 3), "quadrature space must have the quadrature_degree"),
    ]:
        with rejected(message):
            dm.Solid(u, dm.Elastic(E, 0.3))
