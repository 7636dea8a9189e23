# SPDX-License-Identifier: MIT
"""Tables of values at places: what one distribution writes, any other one reads."""

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
from dolfinx import fem
from dolfinx_mortar.persistence.tables import find_places, read_about, read_tables, write
from tests.cases.meshes import two_blocks
from tests.cases.solid import CELLS, create_domain

COMM = MPI.COMM_WORLD


@pytest.fixture
def file(tmp_path):
    """Return a file that all ranks see."""
    return COMM.bcast(tmp_path) / "x.h5"


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
    values = {"x": values_at(written), "none": {"a": none}}
    write(COMM, file, given, {"x": written, "none": none}, values)
    about = read_about(COMM, file)
    assert about["text"] == "ä" and about["numbers"] == [0.1, 1 / 3, np.inf]
    found, differ = read_tables(COMM, file, about, {"x": wanted, "none": none}, 1.0)
    assert not differ
    for name, values in values_at(wanted).items():
        assert np.array_equal(found["x"][name], values)
    assert found["none"]["a"].shape == (0, 4)


def _block(array):
    """Return this rank's block of consecutive rows."""
    return array[len(array) * COMM.rank // COMM.size : len(array) * (COMM.rank + 1) // COMM.size]


@pytest.mark.mpi
def test_places_that_are_moved_are_told(file, rng):
    places = rng.uniform(0.0, 1.0, (40, 4))
    write(COMM, file, {}, {"x": _block(places)}, {"x": values_at(_block(places))})
    about = read_about(COMM, file)
    noise = places + 1e-14 * rng.uniform(-1.0, 1.0, places.shape)
    assert read_tables(COMM, file, about, {"x": _block(noise)}, 1.0)[1] == {}
    moved = places.copy()
    moved[[3, 30], 0] += 1e-8
    _, differ = read_tables(COMM, file, about, {"x": _block(moved)}, 1.0)
    assert differ["x"].startswith("2 of 40 are not in the checkpoint, such as that at (")
    _, differ = read_tables(COMM, file, about, {"x": _block(places[:-1])}, 1.0)
    assert differ["x"] == "there are 39, in the checkpoint 40"


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


@pytest.mark.mpi
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("partition", ["stripes", "bodies", "empty"])
def test_nodes_of_sides_that_touch_are_told_apart(partition, order):
    """All places are different, and the same as those of one rank."""
    mesh, *_ = two_blocks(COMM, (3, 2), (3, 2), partition=partition, order=order)
    alone, *_ = two_blocks(MPI.COMM_SELF, (3, 2), (3, 2), order=order)
    found = np.concatenate(COMM.allgather(_places(mesh, order)))
    expected = _places(alone, order)
    distance = np.linalg.norm(found[:, None] - expected[None], axis=-1)
    assert (np.sum(distance < 1e-13, axis=0) == 1).all()
    assert (np.sum(distance < 1e-3, axis=0) == 1).all()
    assert len(np.unique(np.round(found[:, :2], 9), axis=0)) < len(found) == len(expected)


def _places(mesh, order):
    return find_places(fem.functionspace(mesh, ("Lagrange", order, (2,))))
