# SPDX-License-Identifier: MIT
"""A half ball pressed on a block and pushed sideways, in 3D, beside Mindlin and Deresiewicz."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem

COMM = MPI.COMM_WORLD
RADIUS, DEPTH, MU, E, NU = 20.0, 0.03, 0.2, 206_900.0, 0.29
SIDES = {"block": ("top", "sphere"), "ball": ("sphere", "top")}


def pushed_ball(h, slave, pushes, cell="hexahedron"):
    """Press without friction, as the theory has it, then push; yield rows beside Mindlin.

    The ball is large beside the contact, whose radius is 0.78. A row holds numbers of both whole
    bodies: the motion, the force, Mindlin's solution, errors of tractions over mu p0 (the largest
    beyond 1.5 h from the edges, and the mean), the radius that sticks, the energy.
    """
    mesh, _, tags = dm.meshing.sphere(
        COMM, cell=cell, h=h, radius=RADIUS, block=(60.0, 60.0, 30.0), core=1.0, half=True
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    solid = dm.Solid(fem.Function(V), dm.Elastic(E, NU))
    flat, friction = fem.Constant(mesh, np.zeros(3)), fem.Constant(mesh, 0.0)
    W = V.sub(1)
    bcs = [
        fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, tags.find("bottom")), V),
        fem.dirichletbc(flat, fem.locate_dofs_topological(V, 2, tags.find("flat")), V),
        fem.dirichletbc(0.0, fem.locate_dofs_topological(W, 2, tags.find("symmetry_y")), W),
    ]
    side, master = SIDES[slave]
    contact = dm.Contact(tags, slave=side, master=master, friction=friction)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry="reference")
    sign, path = (1.0 if slave == "block" else -1.0), []
    for k, push in enumerate([0.0, *pushes]):
        flat.value[:], friction.value = (push, 0.0, -DEPTH), MU if k else 0.0
        dm.newton(problem)
        problem.commit()
        if k == 0:
            continue
        force = 2.0 * sign * contact.force
        hertz = dm.analytic.hertz_point(-force[2], RADIUS, E, NU, E, NU)
        turned = len(path) > 1 and (path[-1] - path[-2]) * (force[0] - path[-1]) > 0.0
        turned |= len(path) == 1 and path[0] * (force[0] - path[0]) > 0.0
        path = [*(path[:-1] if turned else path), float(force[0])]
        bound = abs(path[0])
        state = dm.analytic.mindlin_point(
            hertz, MU, NU, tuple(float(np.clip(Q, -bound, bound)) for Q in path)
        )
        yield measure(contact.gather(solid.u), sign, state, h) | {
            "push": push,
            "state": state,
            "energy": 2.0 * contact.dissipation,
        }


def measure(nodes, sign, state, h):
    """Return the errors of tractions, and the radius of what sticks."""
    r, q = np.hypot(*nodes["X"][:, :2].T), sign * nodes["traction"][:, 0]
    a = state.contact.contact_radius
    error = np.abs(q - state.traction(r)) / (MU * state.contact.peak_pressure)
    edges = np.array([a, *state.stick_radii])
    away = (np.abs(r[:, None] - edges) > 1.5 * h).all(axis=1)
    sticks = nodes["status"] == 1
    return {
        "error": error[away].max(),
        "mean_error": error[r < a].mean(),
        "sticks": r[sticks].max(initial=0.0),
    }


def check(rows, h, traction):
    """Tractions, stick zone, and a compliance of the bodies that is the same in all states."""
    for row in rows:
        assert row["error"] < traction and row["mean_error"] < traction
        assert abs(row["sticks"] - row["state"].stick_radius) < h
    left = [(row["push"] - row["state"].displacement) / row["state"].force for row in rows]
    half_spaces = rows[0]["state"].displacement / rows[0]["state"].force
    assert 0.0 < min(left) and max(left) < 0.15 * half_spaces
    assert np.ptp(left) < 0.02 * half_spaces


@pytest.mark.slow
def test_a_ball_pushed_sideways():
    """Three facets in the radius of the contact."""
    rows = list(pushed_ball(0.25, "block", (0.003, 0.006)))
    assert rows[-1]["state"].force > 0.85 * MU * rows[-1]["state"].contact.force
    check(rows, 0.25, 0.05)
    assert rows[-1]["energy"] == pytest.approx(rows[-1]["state"].dissipation, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("slave", ["block", pytest.param("ball", marks=pytest.mark.nightly)])
def test_a_ball_pushed_to_and_fro(slave):
    """Six facets in the radius: tractions and energy of a closed loop."""
    rows = list(pushed_ball(0.125, slave, (0.005, -0.005, 0.005)))
    check(rows, 0.125, 0.02)
    first, _, last = rows
    assert last["state"].force == pytest.approx(first["state"].force, rel=1e-3)
    loop = last["state"].dissipation - first["state"].dissipation
    assert last["energy"] - first["energy"] == pytest.approx(loop, rel=0.05)
