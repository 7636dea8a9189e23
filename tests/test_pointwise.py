# SPDX-License-Identifier: MIT
"""Laws that are functions of numbers, against the same laws in UFL, and their mistakes."""

import importlib.util
import subprocess
import sys

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.pointwise_laws import Compiled, OneSided, Radial, nan_last, spoilt
from tests.cases.solid import (
    CELLS,
    COMM,
    STEEL,
    create_domain,
    largest,
    residual,
    set_wave,
    solid_on,
    total,
)
from tests.choice import quick

NUMBERS = (STEEL.E, STEEL.nu, STEEL.Y, STEEL.a)


def compare(solid, other):
    """Walk both through two steps and compare all that a step needs."""
    for phase in (0.0, 0.7):
        for s in (solid, other):
            set_wave(s.u, 2e-3, phase)
        expected = residual(other)
        assert largest(residual(solid) - expected) < 1e-12 * largest(expected)
        K, L = solid.create_matrix(), other.create_matrix()
        solid.assemble_tangent(K)
        other.assemble_tangent(L)
        K.axpy(-1.0, L)
        assert K.norm() < 1e-11 * L.norm()
        assert solid.element_force_norm() == pytest.approx(other.element_force_norm(), rel=1e-12)
        for s in (solid, other):
            s.evaluate()
        assert largest(solid.stress.x.array - other.stress.x.array) < 1e-9
        flowing = solid.points.flowing()
        assert np.array_equal(flowing, other.points.flowing()) and total(flowing) > 0
        for s in (solid, other):
            s.commit()
        ep, expected = (s.state["plastic_strain"].x.array for s in (solid, other))
        assert largest(ep - expected) < 1e-14
    assert solid.max("back_stress_norm") == pytest.approx(other.max("back_stress_norm"), rel=1e-11)


RING, MEAN = {"kinematics": "axisymmetric"}, {"volumetric": "reduced", "eigenstrain": 1e-4}
CASES = [
    *((law, cell, 1, {}) for law, cell in zip((Radial, Compiled, OneSided), CELLS, strict=False)),
    (Compiled, "triangle", 1, RING),
    (Radial, "quadrilateral", 1, MEAN),
    (Compiled, "triangle", 2, {}),
    (Compiled, "quadrilateral", 1, RING | MEAN),
]


@pytest.mark.mpi
@pytest.mark.parametrize(("law", "cell", "degree", "options"), quick(CASES, *CASES[:5]))
def test_the_law_in_numbers_is_the_law_in_ufl(law, cell, degree, options):
    """NumPy and numba against UFL: forces, tangent, stress, state over two steps."""
    domain = create_domain(cell, 3)
    solids = [solid_on(domain, m, degree=degree, **options) for m in (law(*NUMBERS), STEEL)]
    assert solids[0].energy() is None and solids[1].energy() is not None
    compare(*solids)


MISTAKES = [
    (
        {"stress": nan_last},
        r"Spoilt.update gives NaN or infinity at 1 .*first at point 0 of the cell around \(0\.",
    ),
    (
        {"stress": lambda s: s[:, 0]},
        r"the stress has the shape \((\d+), 3\) at \1 points; it must be \(\1, 3, 3\)",
    ),
    ({"plastic_strain": lambda e: e[0]}, r"plastic_strain has the shape \(3, 3\)"),
    ({"stress": lambda s: "stress"}, r"the stress is a str; it must be an array"),
    (
        {"plastic_strain": lambda e: None},
        r"returns the state nothing, but `state` declares plastic_strain",
    ),
    ({"stress": lambda s: 1 // 0}, r"Spoilt.update raised ZeroDivisionError"),
]


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
@pytest.mark.parametrize(("changes", "message"), MISTAKES)
def test_mistakes_are_named_on_all_ranks(changes, message):
    with pytest.raises(ValueError, match=message):
        solid = solid_on(create_domain("triangle"), spoilt(**changes))
        solid.evaluate()


@pytest.mark.mpi
def test_nan_on_one_rank_is_raised_on_all():
    law = spoilt(stress=nan_last) if COMM.rank == COMM.size - 1 else spoilt(stress=np.copy)
    solid = solid_on(create_domain("triangle"), law)
    for ask in (solid.evaluate, solid.element_force_norm):
        with pytest.raises(ValueError, match=r"Spoilt.update gives NaN or infinity at 1 integr"):
            ask()


def test_an_unsymmetric_tangent_is_stored_by_its_symmetric_part():
    skew = np.zeros((3, 3, 3, 3))
    skew[0, 0, 1, 1], skew[1, 1, 0, 0] = 5.0, -5.0
    laws, domain = (spoilt(), spoilt(tangent=lambda C: C + skew)), create_domain("triangle")
    compare(*(solid_on(domain, law) for law in laws))
