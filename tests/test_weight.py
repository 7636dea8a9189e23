# SPDX-License-Identifier: MIT
"""Operators with a factor of all integrals, such as 2 pi r of rings."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
from dolfinx_mortar.mortar.assembly import assemble_mortar
from dolfinx_mortar.mortar.duals import node_weights
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing
from dolfinx_mortar.mortar.surface import create_surface
from tests.cases.meshes import two_blocks
from tests.cases.mortar import operators, owned_coordinates, space, vector_of

COMM = MPI.COMM_WORLD
EXACT = 1e-12
pytestmark = pytest.mark.mpi


def ring(points):
    """Return 2 pi r at points (q, d) of a meridian plane, r = x[0]."""
    return 2 * np.pi * points[:, 0]


@pytest.mark.parametrize("slave", [3, 4])
@pytest.mark.parametrize("x", [(0.0, 1.0), (2.0, 3.0)])
def test_a_weight_is_in_every_integral(slave, x):
    """With 2 pi r: D are the integrals over the swept disc, biorthogonal, also on the axis."""
    mesh, _, tags = two_blocks(COMM, (3, 2), (5, 3), x_lower=x, x_upper=x, jitter=0.4)
    V = space(mesh)
    surfaces = [create_surface(V, tags, tag, "side") for tag in (slave, 7 - slave)]
    pairing = create_pairing(V, *surfaces, None, weight=ring)
    points, _ = find_segments(pairing, None)
    covered, tributary = node_weights(pairing, points)
    assert np.abs(covered / tributary - 1).max(initial=0) < EXACT
    D, M, keep = operators(pairing)
    d = D.getDiagonal().array[surfaces[0].nodes[: surfaces[0].owned]]
    assert keep.all() and (d > 0).all() and np.abs(d - covered[: len(d)]).max(initial=0) < EXACT
    total = COMM.allreduce(d.sum())
    assert abs(total / (np.pi * (x[1] ** 2 - x[0] ** 2)) - 1) < EXACT
    start, columns, entries = D.getValuesCSR()
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start)) + D.getOwnershipRange()[0]
    assert (entries[rows != columns] == 0.0).all()
    # D and M transfer linear functions, and a constant pressure weighs each node by int N_l 2 pi r
    linear = vector_of(D, owned_coordinates(V) @ [0.7, -0.3] + 0.2)
    assert np.abs((D * linear - M * linear).array).max(initial=0) < EXACT
    ones, pushed = D.createVecLeft(), D.createVecRight()
    ones.array[surfaces[0].nodes[: surfaces[0].owned]] = 1.0
    M.multTranspose(ones, pushed)
    swapped = create_pairing(V, *surfaces[::-1], None, weight=ring)
    _, expected = node_weights(swapped, find_segments(swapped, None)[0])
    own = surfaces[1].nodes[: surfaces[1].owned]
    assert np.abs(pushed.array[own] - expected[: len(own)]).max(initial=0) < EXACT


def test_the_weight_is_that_of_the_points_at_the_start():
    """A ring that grows keeps its weight, and areas grow with the length of its section."""
    mesh, _, tags = two_blocks(COMM, x_lower=(1.0, 2.0), x_upper=(1.0, 2.0))
    V = space(mesh)
    u = dolfinx.fem.Function(V)
    u.interpolate(lambda x: np.stack([x[0], 0 * x[1]]))
    surfaces = [create_surface(V, tags, tag, "side") for tag in (3, 4)]
    areas = []
    for at in (None, u):
        pairing = create_pairing(V, *surfaces, at, weight=ring)
        areas.append(COMM.allreduce(find_segments(pairing, at)[0].weight.sum()))
    assert np.allclose(areas, 3 * np.pi * np.array([1.0, 2.0]), rtol=1e-12)


def test_the_papers_matrices_may_have_a_weight():
    """Over a disc: D sums up to its area in each component, constants pass, N as ever."""
    mesh, _, tags = two_blocks(COMM, (3, 2), (5, 3))
    V = space(mesh)
    plain, weighted = (
        assemble_mortar(V, tags, slave=3, master=4, weight=weight) for weight in (None, ring)
    )
    total = COMM.allreduce(weighted.D.getValuesCSR()[2].sum())
    assert abs(total - 2 * np.pi) < EXACT
    ones = weighted.D.createVecRight()
    ones.set(1.0)
    assert np.abs((weighted.D * ones - weighted.M * ones).array).max(initial=0) < EXACT
    difference = weighted.N.copy()
    difference.axpy(-1.0, plain.N)
    assert difference.norm() < EXACT
