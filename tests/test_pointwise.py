# SPDX-License-Identifier: MIT
"""Laws that are functions of numbers, against the same laws in UFL, and their mistakes."""

import importlib.util
import subprocess
import sys
from dataclasses import dataclass
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.materials.tensor import INDEX
from dolfinx_mortar.solid.pointwise import packed
from tests.cases.pointwise_laws import UNIT, VOLUME, Compiled, OneSided, Radial
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.solid import (
    COMM,
    STEEL,
    create_displacement,
    create_domain,
    create_tags,
    residual,
    set_wave,
    total,
)
from tests.choice import crosswise

NUMBERS = (STEEL.E, STEEL.nu, STEEL.Y, STEEL.a)


def compare(solid, other):
    """Walk both through two steps and compare all that a step needs."""
    for size, phase in ((2e-3, 0.0), (2e-3, 0.7)):
        for s in (solid, other):
            set_wave(s.u, size, phase)
        forces, expected = residual(solid), residual(other)
        largest = COMM.allreduce(np.abs(expected).max(initial=0.0), op=MPI.MAX)
        assert np.abs(forces - expected).max(initial=0.0) < 1e-12 * largest
        K, L = solid.create_matrix(), other.create_matrix()
        solid.assemble_tangent(K)
        other.assemble_tangent(L)
        K.axpy(-1.0, L)
        assert K.norm() < 1e-11 * L.norm()
        assert solid.element_force_norm() == pytest.approx(other.element_force_norm(), rel=1e-12)
        for s in (solid, other):
            s.evaluate()
        assert np.abs(solid.stress.x.array - other.stress.x.array).max() < 1e-9
        flowing = solid.points.flowing()
        assert np.array_equal(flowing, other.points.flowing()) and total(flowing) > 0
        for s in (solid, other):
            s.commit()
        ep = [s.state["plastic_strain"].x.array for s in (solid, other)]
        assert np.abs(ep[0] - ep[1]).max() < 1e-14
    assert solid.max("back_stress_norm") == pytest.approx(other.max("back_stress_norm"), rel=1e-11)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("law", "cell"),
    crosswise([Radial, Compiled, OneSided], ["triangle", "quadrilateral", "tetrahedron"]),
)
def test_the_law_in_numbers_is_the_law_in_ufl(cell, law):
    """NumPy and numba against UFL: forces, tangent, stress, state over two steps."""
    domain = create_domain(cell, 3)
    solid, other = (dm.Solid(create_displacement(domain), m) for m in (law(*NUMBERS), STEEL))
    assert solid.energy() is None and other.energy() is not None
    compare(solid, other)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("kinematics", "degree"),
    [("axisymmetric", 1), pytest.param("plane_strain", 2, marks=pytest.mark.slow)],
)
def test_on_rings_and_of_second_order(kinematics, degree):
    """The strain around a ring, and the points of quadratic cells, reach the law."""
    domain = create_domain("triangle", 3)
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    compare(
        *(dm.Solid(fem.Function(V), m, kinematics=kinematics) for m in (Compiled(*NUMBERS), STEEL))
    )


@pytest.mark.mpi
@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "kinematics"), [("quadrilateral", "axisymmetric"), ("hexahedron", None)]
)
def test_with_one_dilatation_per_cell(cell, kinematics):
    """The law sees the deviator; the mean stress, and its tangent, come in once."""
    domain = create_domain(cell, 3)
    options = {"volumetric": "reduced", "kinematics": kinematics, "eigenstrain": 1e-4}
    laws = (Compiled(*NUMBERS), STEEL)
    compare(*(dm.Solid(create_displacement(domain), law, **options) for law in laws))


@pytest.mark.mpi
@pytest.mark.slow
def test_beside_laws_in_ufl_with_parameters_and_eigenstrain():
    """Three laws by tag, a Constant and a Function as parameters, and a thermal strain."""
    domain = create_domain("quadrilateral", 6)
    tags = create_tags(domain, lambda x: (3 * x[:, 0] * 0.999).astype(int))
    Y = fem.Constant(domain, default_scalar_type(300.0))
    a = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    a.interpolate(lambda x: 5000.0 * (1 + x[0]))
    rest = {0: dm.Elastic(STEEL.E, 0.2), 2: dm.VonMises(STEEL.E, 0.29, 400.0, 0.0, 1000.0)}
    solids = [
        dm.Solid(
            create_displacement(domain),
            rest | {1: law(STEEL.E, 0.29, Y, a)},
            tags,
            eigenstrain={1: 1e-3},
        )
        for law in (Compiled, dm.VonMises)
    ]
    compare(*solids)
    Y.value = 250.0
    compare(*solids)


@pytest.mark.mpi
def test_the_law_is_asked_only_when_something_has_changed():
    """Residual, tangent and element forces at one displacement and state are one evaluation."""
    calls = []

    @dataclass(frozen=True)
    class Counted(Radial):
        @staticmethod
        def update(strain, state, p):
            calls.append(len(strain))
            return Radial.update(strain, state, p)

    solid = dm.Solid(create_displacement(create_domain("triangle")), Counted(*NUMBERS))
    K = solid.create_matrix()
    for step in range(3):
        set_wave(solid.u, 2e-3, float(step))
        residual(solid)
        solid.assemble_tangent(K)
        solid.evaluate()
        assert len(calls) == 2 * step + 1
        solid.commit()
        residual(solid)  # the committed state is another one
        assert len(calls) == 2 * step + 2


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", [None, pytest.param("axisymmetric", marks=pytest.mark.slow)])
def test_the_volumetric_part_may_be_reduced(kinematics):
    """The law sees the deviator, as one in UFL does, and the mean stress is not counted twice."""

    @dataclass(frozen=True)
    class Split(Radial):
        splits: ClassVar = True

    domain = create_domain("quadrilateral", 3)
    options = {"kinematics": kinematics, "volumetric": "reduced"}
    compare(
        *(dm.Solid(create_displacement(domain), m, **options) for m in (Split(*NUMBERS), STEEL))
    )


@pytest.mark.mpi
def test_contact_with_a_pointwise_law():
    """Pressed blocks that flow: Newton converges to the force of the law in UFL."""
    forces = []
    for law in (dm.VonMises, Compiled):
        case = PressedBlocks()
        solid = dm.Solid(case.u, law(1000.0, 0.3, 1.0, 100.0))
        problem = dm.ContactProblem(solid, [case.contact()], bcs=case.bcs())
        report = dm.newton(problem, rtol=1e-10)
        assert report.converged and solid.max("plastic_strain_norm") > 1e-4
        forces.append(problem.contacts[0].force)
    assert forces[1] == pytest.approx(forces[0], rel=1e-8)


def test_check_judges_pointwise_laws():
    """The same judgement as for UFL."""
    for law in (Radial, Compiled, OneSided):
        report = dm.materials.check(law(1000.0, 0.3, 1.0, 100.0))
        assert report.changed > 10 and report.tangent_error < 1e-8 and report.skew < 1e-12
        assert report.state_error < 1e-12 and np.isnan(report.energy_error)


def spoilt(**changes):
    """Return a law whose results are changed: stress=, tangent=, plastic_strain= of the right."""

    @dataclass(frozen=True)
    class Spoilt(Radial):
        @staticmethod
        def update(strain, state, p):
            stress, tangent, new = Radial.update(strain, state, p)
            found = {"stress": stress, "tangent": tangent, **new}
            found |= {name: change(found[name]) for name, change in changes.items()}
            return (
                found.pop("stress"),
                found.pop("tangent"),
                {name: value for name, value in found.items() if value is not None},
            )

    return Spoilt(1000.0, 0.3, 1.0, 100.0)


def nan_last(values):
    values = values.copy()
    values[-1:] = np.nan
    return values


MISTAKES = {
    "nan": (
        {"stress": nan_last},
        r"Spoilt.update gives NaN or infinity at 1 .*first at point 0 of the cell around \(0\.",
    ),
    "nan tangent": ({"tangent": nan_last}, "Spoilt.update gives NaN or infinity at 1"),
    "nan state": ({"plastic_strain": nan_last}, "Spoilt.update gives NaN or infinity at 1"),
    "stress shape": (
        {"stress": lambda s: s[:, 0]},
        r"the stress has the shape \((\d+), 3\) at \1 points; it must be \(\1, 3, 3\)",
    ),
    "tangent shape": ({"tangent": lambda t: t[..., 0]}, r"the tangent has the shape"),
    "state shape": ({"plastic_strain": lambda e: e[0]}, r"plastic_strain has the shape \(3, 3\)"),
    "no array": ({"stress": lambda s: "stress"}, r"the stress is a str; it must be an array"),
    "forgotten": (
        {"plastic_strain": lambda e: None},
        r"returns the state nothing, but `state` declares plastic_strain",
    ),
    "raises": ({"stress": lambda s: 1 // 0}, r"Spoilt.update raised ZeroDivisionError"),
}


CACHED = """
import numba

@numba.njit(cache=True)
def twice(values):
    return 2.0 * values
"""


def test_a_cache_of_another_name_is_named(tmp_path):
    """One program imports a file by its name; another, which knows it by another one, calls it."""
    file = tmp_path / "first_name.py"
    file.write_text(CACHED)
    program = "import first_name, numpy; first_name.twice(numpy.ones(3))"
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    found = importlib.util.spec_from_file_location("other_name", file)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    law = spoilt(stress=lambda s: module.twice(np.ones(3)))
    with pytest.raises(ValueError, match=r"as first_name: delete the __pycache__ beside it"):
        dm.materials.check(law)


@pytest.mark.mpi
@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named_on_all_ranks(mistake):
    changes, message = MISTAKES[mistake]
    with pytest.raises(ValueError, match=message):
        solid = dm.Solid(create_displacement(create_domain("triangle")), spoilt(**changes))
        solid.evaluate()


@pytest.mark.mpi
def test_nan_on_one_rank_is_raised_on_all():
    law = spoilt(stress=nan_last) if COMM.rank == COMM.size - 1 else spoilt(stress=np.copy)
    solid = dm.Solid(create_displacement(create_domain("triangle")), law)
    for ask in (solid.evaluate, solid.element_force_norm):
        with pytest.raises(ValueError, match=r"Spoilt.update gives NaN or infinity at 1 integr"):
            ask()


def test_what_is_no_tuple_of_three():
    @dataclass(frozen=True)
    class Short(Radial):
        @staticmethod
        def update(strain, state, p):
            return strain

    with pytest.raises(ValueError, match=r"Short.update returns ndarray; it must return stress, "):
        dm.materials.check(Short(*NUMBERS))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"tangent": lambda t: 1.01 * t},
            "Spoilt: the tangent along D .* differences of",
        ),
        ({"plastic_strain": lambda e: 0.9 * e}, "after a commit at the same strain it is"),
        ({"stress": lambda s: s + 0.01 * np.triu(s, 1)}, "mirrored it is"),
        ({"stress": nan_last}, "gives NaN or infinity at strain"),
    ],
)
def test_check_finds_what_does_not_fit(changes, message):
    with pytest.raises(ValueError, match=message):
        dm.materials.check(spoilt(**changes))


def test_an_unsymmetric_tangent_is_stored_by_its_symmetric_part():
    given = 300.0 * VOLUME + 100.0 * UNIT
    skew = np.zeros((3, 3, 3, 3))
    skew[0, 0, 1, 1], skew[1, 1, 0, 0] = 5.0, -5.0
    expected = packed(given[None], INDEX)
    assert np.allclose(packed((given + skew)[None], INDEX), expected)
