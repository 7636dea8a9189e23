# SPDX-License-Identifier: MIT
"""Tables of values at places: what one distribution writes, any other one reads."""

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
from dolfinx import fem
from dolfinx_mortar.persistence.checkpoints import (
    PLACES,
    find_places,
    read_about,
    read_tables,
    write,
)
from tests.cases.solid import CELLS, create_domain

COMM = MPI.COMM_WORLD


@pytest.fixture
def file(folder):
    """Return a file that all ranks see."""
    return folder / "x.h5"


def share(array, rng):
    """Return this rank's part of an array whose rows are dealt out at random, unevenly."""
    rank = rng.integers(0, COMM.size, len(array)) * rng.integers(0, 2, len(array))
    return array[rank == COMM.rank]


def values_at(places):
    """Return two fields of the places."""
    return {"a": np.sin(places @ np.arange(1.0, 1 + places.shape[1]))[:, None], "b/c": places**2}


@pytest.mark.mpi
def test_rows_are_dealt_out_anew(file, rng):
    places = rng.uniform(-1.0, 1.0, (101, 4))
    written, wanted = share(places, rng), share(rng.permutation(places), rng)
    none = np.zeros((0, 4))
    given = {"text": "ä", "numbers": [0.1, np.float64(1 / 3), np.inf]}
    values = {"x": {PLACES: written} | values_at(written), "none": {PLACES: none, "a": none}}
    write(COMM, file, given, values)
    about = read_about(COMM, file)
    assert about["text"] == "ä" and about["numbers"] == [0.1, 1 / 3, np.inf]
    found, differ = read_tables(COMM, file, about, {"x": wanted, "none": none}, 1.0)
    assert not differ
    for name, values in values_at(wanted).items():
        assert np.array_equal(found["x"][name], values)
    assert found["none"]["a"].shape == (0, 4)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 3])
def test_places_of_points_are_where_they_are(cell, degree):
    domain = create_domain(cell, 2)
    d = domain.geometry.dim
    element = basix.ufl.quadrature_element(domain.basix_cell(), degree=degree, value_shape=(4,))
    V = fem.functionspace(domain, element)
    places, n = find_places(V), V.dofmap.index_map.size_local
    x = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))))
    x.interpolate(lambda x: x[:d])
    at_points = fem.Expression(x, basix.make_quadrature(domain.basix_cell(), degree)[0])
    owned = np.arange(domain.topology.index_map(domain.topology.dim).size_local, dtype=np.int32)
    expected = np.asarray(at_points.eval(domain, owned)).reshape(-1, d)
    assert places.shape == (n, 2 * d)
    assert np.allclose(places[V.dofmap.list[owned].ravel(), :d], expected, rtol=0, atol=1e-14)
    middle = places[V.dofmap.list[owned], d:]
    assert np.allclose(middle, middle[:, :1], rtol=0, atol=1e-14)
