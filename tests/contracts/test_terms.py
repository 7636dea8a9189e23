# SPDX-License-Identifier: MIT
"""What every term passes beside a solid: forces and tangent are derivatives of the energy."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.pressed_blocks import COMM
from tests.cases.solid import (
    create_displacement,
    errors_of_derivatives,
    plane,
    rectangle,
    set_wave,
    tag_facets,
)
from tests.choice import quick

pytestmark = pytest.mark.mpi
SIZE = np.array([2.0, 1.5, 1.0])
ELASTIC, RUBBER = dm.Elastic(10.0, 0.3), dm.NeoHooke(10.0, 0.3)
WAY = np.array([[2.0, -1.0, 0.5], [-1.0, 3.0, 0.0], [0.5, 0.0, 1.0]])  # positive definite


def potential(form):
    """Return how to make a term of a form of u, x, n and ds, of the bottom 1 and the top 2."""

    def make(solid):
        domain, d = solid.mesh, solid.mesh.geometry.dim
        tags = tag_facets(domain, plane(d - 1), plane(d - 1, SIZE[d - 1]))
        x, n = ufl.SpatialCoordinate(domain), ufl.FacetNormal(domain)
        ds = ufl.Measure("ds", domain, subdomain_data=tags)
        return [dm.WeakForm(solid, energy=form(solid.u, x, n, ds))]

    return make


def pressure(solid):
    tags = tag_facets(solid.mesh, lambda x: np.full(x.shape[1], True))
    return [dm.Pressure(solid, tags, 1, 2.0, closed=True)]


def points(solid):
    V, d = solid.V, solid.mesh.geometry.dim
    corner = np.r_[1.0, np.zeros(d - 1)]
    corner[-1] = SIZE[d - 1]
    return [
        dm.PointForce(V, corner, np.arange(1.0, 1.0 + d)),
        dm.PointSpring(V, corner, WAY[:d, :d]),
        dm.PointSpring(V, np.r_[2.0, SIZE[1:d]], 7.0),
    ]


def quartic(u, x, n, ds):
    return ufl.inner(u, u) ** 2 * ds(2)


SHAPES = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}
CASES = {
    "weighted": (potential(lambda u, x, n, ds: x[0] * u[0] ** 2 * ds(1, degree=4)), 3, {}, True),
    "dead": (potential(lambda u, x, n, ds: -3.0 * ufl.inner(u, n) * ds(2)), 3, {}, True),
    "both": (
        potential(lambda u, x, n, ds: ufl.exp(u[0]) * ds(1) + u[1] ** 2 * ufl.dx),
        2,
        {},
        False,
    ),
    "ring": (potential(quartic), 2, {"kinematics": "axisymmetric"}, False),
    "points": (points, 2, {}, True),
    "points in space": (points, 3, {}, True),
    "pressure": (pressure, 2, {"strain": "finite"}, False),
    "pressure in space": (pressure, 3, {"strain": "finite"}, False),
    "pressure of a ring": (pressure, 2, {"strain": "finite", "kinematics": "axisymmetric"}, False),
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    "name", quick(CASES, "both", "ring", "points in space", "pressure", "pressure in space")
)
def test_forces_and_tangent_are_derivatives(name, degree):
    make, d, options, linear = CASES[name]
    low = np.r_[1.0, np.zeros(d - 1)]  # no axis
    domain = rectangle([low, low + SIZE[:d] - (low > 0)], d * [2], SHAPES[d][degree - 1])
    u = create_displacement(domain, degree)
    law = RUBBER if options.get("strain") else ELASTIC
    solid, v = dm.Solid(u, law, **options), fem.Function(u.function_space)
    terms = make(solid)
    sum_of = dm.ContactProblem(solid, terms=terms).terms
    assert all(term.linear is linear for term in terms)
    sum_of.begin(0.0, 0.0)
    set_wave(u, 0.1)
    set_wave(v, 1.0, 1.0)
    K = sum_of.create_matrix()
    sum_of.assemble_tangent(K)

    def forces():
        F = u.x.petsc_vec.duplicate()
        sum_of.assemble_forces(F)
        return F.array.copy()

    found = errors_of_derivatives(
        u, lambda: sum_of.energy().value / COMM.size, forces, K, v, h=1e-4
    )
    assert max(found) < 1e-8
    assert K.isSymmetric(1e-12 * K.norm())
