# SPDX-License-Identifier: MIT
"""Results of interfaces: none before a step, nodal values of ties, sides that share nodes."""

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx.mesh import create_mesh
from tests.cases.meshes import BOTTOM, TOP, _block, _tag
from tests.cases.pressed_blocks import COMM, ELASTIC, PressedBlocks, rejected
from tests.test_stack import BESIDE, P, press, press_beside

RESULTANTS = ("force", "moment", "master_force", "master_moment", "multiplier")


def test_asking_before_the_first_step():
    """A clear error with a problem or without; ``hasattr`` still works."""
    case = PressedBlocks()
    contact = case.contact()
    for name in (*RESULTANTS, "pressure", "gap", "active"):
        with rejected(
            f"Contact(slave=3, master=4) has no {name} yet", "newton", error=RuntimeError
        ):
            getattr(contact, name)
        assert not hasattr(contact, name)
    problem = case.problem([contact])
    assert not contact.pressure.x.array.any()  # there, so that an output can begin with zeros
    assert not problem.output_fields()["pressure"].x.array.any()
    with rejected("newton", error=RuntimeError):
        contact.gather(case.u)
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1, rtol=1e-15)
    assert not hasattr(contact, "force")
    dm.newton(problem)
    assert all(hasattr(contact, name) for name in RESULTANTS)
    assert len(contact.gather(case.u)["gap"]) > 0


@pytest.mark.mpi
def test_nothing_is_shown_of_an_interface_that_another_problem_has(folder):
    """It would be the results of the other one; what has been written stays."""
    pytest.importorskip("matplotlib")
    case = PressedBlocks()
    contact = case.contact()
    first = case.problem([contact])
    dm.newton(first)
    first.commit()
    writer = dm.Writer(folder / "first.xdmf", first)
    writer.write(1.0)
    written = (folder / "first.xdmf").read_text()
    solid = dm.Solid(fem.Function(case.V), ELASTIC)
    case.top.value[1] = -0.02
    second = case.problem([contact], law=solid)
    dm.newton(second)
    pressure = contact.pressure.x.array.copy()
    for show in (
        lambda: writer.write(2.0),
        first.output_fields,
        lambda: dm.plotting.pressure(first),
        first.audit,
        lambda: dm.reaction(first, BOTTOM, facet_tags=case.facets),
        first.commit,
        lambda: first.save(folder / "first.h5"),
        lambda: list(dm.load_steps(first, [1.0])),
    ):
        with rejected("is also in a problem that was made later", "make a Contact for each"):
            show()
    writer.close()
    assert (folder / "first.xdmf").read_text() == written
    assert np.array_equal(contact.pressure.x.array, pressure)
    second.commit()
    assert np.array_equal(second.output_fields()["pressure"].x.array, pressure)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_a_node_on_two_slave_sides_counts_once(kind):
    """Under a uniform pressure the merged field is that pressure at all slave nodes."""
    problem = press_beside(kind, BESIDE["slave twice"], (13, 1.0))
    fields = problem.output_fields()
    slave = np.logical_or(*(side.on_slave for side in problem.system.sides))
    for name, expected in (("pressure", P), ("status", 1.0), ("gap", 0.0)):
        values = fields[name].x.array
        assert np.abs(values[slave] - expected).max(initial=0.0) < 1e-8
        assert not values[~slave].any()


TIP = 0.5


def cracked():
    """Return a block with a closed crack from its left side to x = TIP, and the tags."""
    ahead = [TIP, 0.75, 1.0]
    lower = _block(np.array([0.0, 0.2, 0.35, *ahead]), np.linspace(-1, 0, 4), "triangle")
    upper = _block(np.array([0.0, 0.1, 0.2, 0.4, *ahead]), np.linspace(0, 1, 4), "triangle")
    points = np.concatenate([lower[0], upper[0]])
    number = np.arange(len(points))
    joined = np.flatnonzero((upper[0][:, 1] == 0.0) & (upper[0][:, 0] >= TIP))
    number[len(lower[0]) + joined] = len(lower[0]) - len(joined) + np.arange(len(joined))
    kept, number = np.unique(number, return_inverse=True)
    cells = number[np.concatenate([lower[1], upper[1] + len(lower[0])])]
    x, y = points[kept].T
    marks = [(1, y == -1.0), (2, y == 1.0), (5, x == 0.0)]
    below, lips = kept < len(lower[0]), (y == 0.0) & (x <= TIP)
    marks += [(20, lips & below), (11, lips & (~below | (x == TIP)))]
    if COMM.rank > 0:  # the first rank has all, dolfinx distributes
        cells, kept = cells[:0], kept[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    mesh = create_mesh(COMM, cells, x=points[kept], e=element)
    return mesh, _tag(mesh, 1, [(tag, lambda i, on=on: on[i]) for tag, on in marks])


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
@pytest.mark.parametrize("sides", [(20, 11), (11, 20)])
def test_forces_on_the_faces_of_a_crack(sides, kind):
    """The tip is on both faces and gets a force on each; the whole of a face has P times TIP."""
    mesh, tags = cracked()
    problem = press(mesh, tags, lambda t: [kind(t, slave=sides[0], master=sides[1])], (2,), (5,), 1)
    (interface,) = problem.interfaces
    (side,) = problem.system.sides
    assert COMM.allreduce(int((side.on_slave & side.on_master)[: side.n_owned].sum())) == 1
    down = -1.0 if sides[0] == 20 else 1.0
    force, moment = down * P * TIP, down * P * TIP**2 / 2
    moved = abs(problem.u.x.array).max(initial=0.0)  # forces act where the nodes are now
    assert interface.force == pytest.approx([0.0, force], abs=1e-9)
    assert interface.master_force == pytest.approx([0.0, -force], abs=1e-9)
    assert interface.moment == pytest.approx([0.0, 0.0, moment], abs=P * COMM.allreduce(moved))
    assert interface.master_moment == pytest.approx(-interface.moment, abs=1e-9)


PRESSURE = 5.0


def ending(law):
    """Return problem, contact and the traction on an upper block that covers [0, 1.1] of [0, 2]."""
    case = PressedBlocks(n_lower=(8, 2), n_upper=(5, 2), x_lower=(0.0, 2.0), x_upper=(0.0, 1.1))
    value = fem.Constant(case.mesh, PRESSURE)
    ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    loads = -value * ufl.TestFunction(case.V)[1] * ds(TOP)
    bcs = [case.bc(BOTTOM), case.roller(TOP, 0)]
    problem = case.problem(bcs=bcs, law=law, loads=loads, geometry="reference")
    return problem, problem.contacts[0], value


@pytest.mark.mpi
def test_gap_is_a_distance_or_flagged():
    """Python users see NaN where there is no gap, files 0 with "facing" 0."""
    problem, contact, _ = ending(dm.Elastic(1000.0, 0.0))
    assert not problem.output_fields()["facing"].x.array.any()  # no step yet
    dm.newton(problem)
    gap = contact.gap.x.array
    fields = problem.output_fields()
    facing = fields["facing"].x.array
    assert np.isfinite(fields["gap"].x.array).all() and set(facing) <= {0.0, 1.0}
    slave = problem.system.sides[0].on_slave
    assert np.array_equal(facing == 1.0, slave & ~np.isnan(gap))
    assert np.array_equal(fields["gap"].x.array[facing == 1.0], gap[facing == 1.0])
    assert not fields["gap"].x.array[facing == 0.0].any()
    nodes = contact.gather(problem.u)
    x = nodes["X"][:, 0]
    beyond = x >= 1.35 - 1e-9  # the facet that holds the end of the master reaches no further
    assert (nodes["pressure"][beyond] == 0.0).all() and np.isnan(nodes["gap"][beyond]).all()
    assert (nodes["pressure"][x < 1.1] > 0.0).all()
    for expected in (0.0, 1.0):
        assert COMM.allreduce(int((facing[slave] == expected).sum())) > 0


@pytest.mark.mpi
def test_a_step_is_shown_before_its_commit():
    """Contact forces, stress, state and written fields are of one step, twice in a row."""
    problem, contact, traction = ending(dm.VonMises(1000.0, 0.0, 3.0, 100.0))
    shown = []
    for level in (PRESSURE, 2 * PRESSURE):
        traction.value = level
        dm.newton(problem)
        before = (problem.solid.max("von_mises"), problem.solid.max("plastic_strain_norm"))
        assert contact.force[1] == pytest.approx(-1.1 * level, rel=1e-6)
        lowest = COMM.allreduce(
            -problem.solid.fields.values("stress_yy").min(initial=0.0), op=MPI.MAX
        )
        assert lowest >= level * (1 - 1e-9)
        written = problem.output_fields()["von_mises"].x.array.copy()
        problem.commit()
        assert before == (problem.solid.max("von_mises"), problem.solid.max("plastic_strain_norm"))
        assert np.array_equal(problem.output_fields()["von_mises"].x.array, written)
        shown.append(before)
    assert shown[1][0] > shown[0][0] > 0.0 and shown[1][1] > shown[0][1] > 0.0
