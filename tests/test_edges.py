# SPDX-License-Identifier: MIT
"""Contact at edges and corners: forces are normal to both sides, whole skins cost what sides do."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.meshes import BOTTOM, BOTTOM_OF_UPPER, LEFT, TOP, TOP_OF_LOWER, skins
from tests.meshes_3d import rotation, two_boxes
from tests.pressed_blocks import ELASTIC, PressedBlocks

COMM = MPI.COMM_WORLD
SIDES = TOP_OF_LOWER, BOTTOM_OF_UPPER
SLAVES = pytest.mark.parametrize(("slave", "master"), [SIDES, SIDES[::-1]])
pytestmark = pytest.mark.mpi


def crossing(x):
    """Turn two cubes so that an edge of one lies across one of the other, both of them tilted."""
    upper = x[:, 2] > 0.5
    low = (x - [0.5, 1.0, 0.0]) @ rotation((1, 0, 0), np.radians(55)).T
    high = (x - [1.0, 0.5, 1.0]) @ rotation((0, 1, 0), np.radians(33)).T
    low[:, 2] -= low[~upper, 2].max()
    high[:, 2] -= high[upper, 2].min()
    return np.where(upper[:, None], high, low)


@SLAVES
def test_forces_of_crossing_edges_are_normal_to_both(slave, master):
    """Without friction: horizontal forces of averaged normals are a fifth of the vertical one."""
    mesh, cells, facets = two_boxes(
        COMM, (2, 2, 2), (2, 2, 2), gap=1.0, cell="hexahedron", transform=crossing
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    dofs = [fem.locate_dofs_topological(V, 2, facets.find(tag)) for tag in (BOTTOM, TOP)]
    moves = np.zeros(3), np.array([0.0, 0.0, -0.08])
    bcs = [fem.dirichletbc(move, at, V) for move, at in zip(moves, dofs, strict=True)]
    contact = dm.Contact(skins(mesh, cells, facets), slave=slave, master=master)
    dm.newton(dm.ContactProblem(dm.Solid(fem.Function(V), ELASTIC), [contact], bcs=bcs))
    *across, along = contact.force
    assert abs(along) > 1.0
    assert np.hypot(*across) < 0.01 * abs(along)


STACKS = {
    "equal": {"n_lower": (4, 4), "n_upper": (5, 5)},
    "small on large": {"n_lower": (6, 4), "n_upper": (4, 4), "x_upper": (0.23, 0.77)},
    "overhang": {"n_lower": (5, 4), "n_upper": (5, 4), "x_upper": (0.5, 1.5)},
}


@SLAVES
@pytest.mark.parametrize("name", STACKS)
def test_whole_skins_do_what_their_sides_do(name, slave, master):
    """In as many iterations, with the same force; averaged normals take five times as many."""
    found = []
    for whole in (False, True):
        b = PressedBlocks(**STACKS[name])
        b.top.value[:] = 0.005, -0.01
        tags = skins(b.mesh, b.cells, b.facets) if whole else b.facets
        contact = b.contact(slave, master, tags)
        report = dm.newton(b.problem([contact]))
        found.append((report.newton_iterations, contact.force))
    (expected, force), (iterations, of_skins) = found
    assert iterations == expected
    assert np.abs(of_skins - force).max() < 1e-3 * np.abs(force).max()


def on_a_corner(x):
    """Turn the upper block so that it stands on a corner, in the middle of the lower one."""
    upper, turned = x[:, 1] > 0.5, (x - [0.0, 1.0]) @ TURN.T
    return np.where(upper[:, None], turned + np.array([0.5, 0.0]), x)


TURN = np.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])


@pytest.mark.parametrize(("pressed", "noted"), [(0.01, False), (0.04, True)])
@SLAVES
def test_a_corner_that_no_node_sees_is_noted(slave, master, pressed, noted):
    """Facets are 1/3 long at least: .05 of that may be lost between the nodes of a slave."""
    b = PressedBlocks(n_lower=(3, 2), n_upper=(2, 2), gap=1.0, transform=on_a_corner)
    b.top.value[:] = 0.0, -pressed
    contact = b.contact(slave, master, skins(b.mesh, b.cells, b.facets))
    report = dm.newton(b.problem([contact]))
    found = [note for note in report.notes if "deep in each other" in note]
    if slave == BOTTOM_OF_UPPER:
        assert found == [] and contact.force[1] > 1.0
        return
    assert len(found) == noted and not contact.active.x.array.any()
    for note in found:
        assert f"around (0.5, {-pressed:.4g}) the sides lie {pressed:.3g} deep" in note
        assert f"{contact}" in note and "let the finer or sharper side be the slave" in note


def test_a_corner_beside_a_clamped_node_does_not_sink_in():
    """The facet from the corner up to the clamped node stands open, and its gap is no mean of it.

    Shared out, it is: the corner then lies .014 deep in the other body, and no force acts.
    """
    b = PressedBlocks(n_lower=(6, 3), n_upper=(2, 1), gap=1.0, transform=on_a_corner)
    b.top.value[:] = 0.0, -0.02
    contact = b.contact(*SIDES[::-1], skins(b.mesh, b.cells, b.facets))
    dm.newton(b.problem([contact]))
    assert contact.force[1] > 1.0
    nodes = contact.gather(b.u)
    corner = np.linalg.norm(nodes["X"] - [0.5, 0.0], axis=1) < 1e-9
    assert nodes["pressure"][corner] > 0.0
    assert np.abs(nodes["gap"][corner]).max() < 1e-9


@SLAVES
def test_pressure_is_constant_beside_a_clamped_node(slave, master):
    """Uniaxial strain, given on the left as well: closed facets share out, one of them in all."""
    b = PressedBlocks(n_lower=(2, 2), n_upper=(1, 2))
    exact = fem.Function(b.V)
    exact.interpolate(lambda x: np.stack([0.0 * x[0], -0.01 * (x[1] + 1.0)]))
    dofs = [fem.locate_dofs_topological(b.V, 1, b.facets.find(t)) for t in (BOTTOM, TOP, LEFT)]
    bcs = [fem.dirichletbc(exact, at) for at in dofs]
    contact = b.contact(slave, master, skins(b.mesh, b.cells, b.facets))
    dm.newton(b.problem([contact], bcs, law=dm.Elastic(1000.0, 0.0)), rtol=1e-11)
    assert np.abs(b.u.x.array - exact.x.array).max(initial=0) < 1e-12
    pressure = contact.gather(b.u)["pressure"]
    assert np.abs(pressure[pressure > 0] - 10.0).max() < 1e-8
