# SPDX-License-Identifier: MIT
"""Patch tests of rings and discs: a uniform pressure, whatever the meshes and the slave."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.mortar import duals
from dolfinx_mortar.mortar.duals import LEAST_WEIGHT
from dolfinx_mortar.mortar.integrals import find_segments
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.cases.rings import SIDES, held_axis, largest
from tests.cases.two_bodies import TwoBodies
from tests.choice import crosswise
from tests.test_patch import beyond

COMM = MPI.COMM_WORLD
E, NU, P = 1000.0, 0.3, 10.0
EXACT = 1e-9


def solve_patch(
    slave,
    lower,
    upper,
    *,
    cell="triangle",
    degree=1,
    kind=dm.Contact,
    shift=0.0,
    unit=1.0,
    geometry="reference",
):
    """Press a disc or ring on another one with the pressure P; return all that is compared."""
    case = TwoBodies(
        cell,
        degree,
        n_lower=(len(lower) - 1, 3),
        n_upper=(len(upper) - 1, 4),
        splits_lower=lower,
        splits_upper=upper,
        transform=lambda x: unit * (x + np.array([0.0, shift])),
    )
    exact = fem.Function(case.V)
    exact.interpolate(lambda x: P / E * np.stack([NU * x[0], shift * unit - x[1]]))
    v, ds = ufl.TestFunction(case.V)[1], ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    loads = -P * v * ds(TOP)
    ends = ((TOP_OF_LOWER, lower, upper[-1], -P), (BOTTOM_OF_UPPER, upper, lower[-1], P))
    for tag, lines, cut, pressure in ends:
        r = ufl.SpatialCoordinate(case.mesh)[0]
        share = beyond(case.mesh, r, unit * cut, unit * np.asarray(lines), 1, weight=lambda r: r)
        loads += pressure * share * v * ds(tag)
    bcs = [case.held(BOTTOM, P / E * unit, 1)]
    bcs += [held_axis(case.V)] if min(lower[0], upper[0]) == 0.0 else []
    interface = case.interface(kind, swap=slave == "upper")
    options = {"kinematics": "axisymmetric", "loads": loads, "geometry": geometry}
    return case.problem([interface], bcs, dm.Elastic(E, NU), **options), interface, exact


def check_patch(problem, interface, exact, area):
    """Compare displacement, pressures and forces with those of the uniaxial stress -P."""
    report = dm.newton(problem, rtol=1e-12)
    error, scale = (
        largest(values) for values in (problem.u.x.array - exact.x.array, exact.x.array)
    )
    assert error < EXACT * scale
    kept = problem.system.link(interface).coupling.kept.any(axis=1)
    pressure = interface.pressure.x.array[problem.system.link(interface).nodes]
    assert largest(pressure[kept] - P) < EXACT * P
    force = P * area  # on the slave side, up or down; across the axis nothing presses
    assert (
        abs(abs(interface.force[1]) / force - 1) < EXACT and abs(interface.force[0]) < EXACT * force
    )
    assert largest(interface.force + interface.master_force) < EXACT * force
    assert report.certificate.moment_balance < EXACT
    assert report.certificate.row_sum_error < EXACT
    assert report.certificate.linear_field_error < EXACT


RADII = {
    "disc": (np.linspace(0, 1, 4), np.linspace(0, 1, 6)),
    "ring": (np.array([1, 1.3, 1.7, 2.5]), np.array([1, 1.55, 1.9, 2.2, 2.5])),
    "lower wider": (np.array([0, 0.2, 0.5, 0.9, 1.4]), np.array([0, 0.3, 0.5, 1.0])),
    "upper wider": (np.array([0, 0.3, 0.5, 1.0]), np.array([0, 0.2, 0.5, 0.9, 1.4])),
    "a little covered": (np.array([0, 0.4, 0.7, 0.999, 1.4]), np.array([0, 0.3, 0.5, 1.0])),
}


CASES = [(name, "triangle", 1) for name in RADII]
CASES += [(name, cell, 2) for name in ("disc", "ring") for cell in ("triangle", "quadrilateral")]


@pytest.mark.mpi
@pytest.mark.parametrize(("kind", "slave"), crosswise([dm.Contact, dm.Tie], SIDES))
@pytest.mark.parametrize(("radii", "cell", "degree"), CASES)
def test_patch(radii, cell, degree, slave, kind):
    """Uniaxial stress across a flat interface: exact, from the axis to the rim.

    Of second order also where the function of the node on the axis has no integral.
    """
    lower, upper = RADII[radii]
    area = np.pi * (min(lower[-1], upper[-1]) ** 2 - lower[0] ** 2)
    problem, *rest = solve_patch(slave, lower, upper, cell=cell, degree=degree, kind=kind)
    assert not [warning for warning in problem.audit().warnings if "Dirichlet" in warning]
    check_patch(problem, *rest, area)
    if degree == 2:
        everywhere = rest[0].pressure.x.array[problem.system.link(rest[0]).nodes]
        assert largest(everywhere - P) < EXACT * P


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_patch_in_other_units_and_elsewhere_on_the_axis(unit):
    check_patch(*solve_patch("lower", *RADII["disc"], unit=unit, shift=30.0), np.pi * unit**2)


@pytest.mark.mpi
@pytest.mark.parametrize("slave", SIDES)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("radii", ["disc", "ring"])
def test_pressure_is_per_area_of_the_geometry(radii, degree, slave):
    """Both discs grow by nu P / E: in radius and along the section, and on the axis as well."""
    lower, upper = RADII[radii]
    now = P / (1 + NU * P / E) ** 2
    expected = ((dm.Contact, "updated", now), (dm.Contact, "reference", P), (dm.Tie, "updated", P))
    for kind, geometry, pressure in expected:
        problem, interface, _ = solve_patch(
            slave, lower, upper, degree=degree, kind=kind, geometry=geometry
        )
        dm.newton(problem, rtol=1e-12)
        found = interface.gather(problem.u)
        assert np.allclose(found["pressure"], pressure, rtol=EXACT, atol=0.0)
        assert (found["active"] == 1.0).all()  # also on the axis, where there is no multiplier
        force = P * np.pi * (lower[-1] ** 2 - lower[0] ** 2)
        assert abs(interface.force[1]) == pytest.approx(force, rel=EXACT)


@pytest.mark.mpi
@pytest.mark.parametrize(("degree", "lift"), [(1, -1e-2), (2, -1e-2), (2, 1e-2)])
def test_friction_of_discs(degree, lift):
    """Where it slips, its traction is the share of the pressure that is shown; nothing is open."""
    mu, (lower, upper) = 0.05, RADII["disc"]
    sizes = {"n_lower": (3, 3), "n_upper": (5, 4), "splits_lower": lower, "splits_upper": upper}
    case = TwoBodies("quadrilateral", degree, **sizes)
    laws, contact = {1: dm.Elastic(E, 0.0), 2: dm.Elastic(E, 0.45)}, case.interface(friction=mu)
    bcs = [case.held(BOTTOM, 0.0, 1), case.held(TOP, lift, 1), held_axis(case.V)]
    options = {"cells": case.cells, "kinematics": "axisymmetric"}
    problem = case.problem([contact], bcs, laws, **options)
    dm.newton(problem, rtol=1e-11)
    found = contact.gather(problem.u)
    closed = lift < 0.0
    assert (found["active"] == closed).all() and found["status"][0] == closed
    assert ((found["status"] > 0.0) == closed).all()
    slips = found["status"] == 2.0
    assert slips.any() == closed
    drag = np.linalg.norm(found["traction"], axis=1)
    assert np.allclose(drag[slips], mu * found["pressure"][slips], rtol=EXACT, atol=0.0)


@pytest.mark.mpi
@pytest.mark.parametrize("slave", SIDES)
def test_who_has_no_weight(slave, monkeypatch):
    """The node on the axis alone, and clearly: half and twice the number, and a tenth, say so."""
    problem, interface, _ = solve_patch(slave, *RADII["disc"], degree=2)
    problem.audit()
    pairing = problem.system.link(interface).pairing
    segments, _ = find_segments(pairing, None)
    at_axis = pairing.slave.X[:, 0] < 1e-12
    for least in (0.1, 0.5, 1.0, 2.0, 10.0):
        monkeypatch.setattr(duals, "LEAST_WEIGHT", least * LEAST_WEIGHT)
        found, share = duals._find_weightless(pairing, segments)
        assert (found == at_axis).all() and share == pytest.approx(1.0, rel=1e-12)
    for absurd, most in ((-1.0, 0), (0.3, 1)):  # nobody; also vertices, of weight 1/6
        monkeypatch.setattr(duals, "LEAST_WEIGHT", absurd)
        found, _ = duals._find_weightless(pairing, segments)
        count = COMM.allreduce(int(found[: pairing.slave.owned].sum()))
        assert count > most if most else count == 0
