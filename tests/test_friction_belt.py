# SPDX-License-Identifier: MIT
"""A belt on a drum, both of its ends pulled alike: friction alone keeps it from going round."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.finite_sliding import Bodies, grid
from tests.cases.two_bodies import create_problem, held
from tests.choice import quick

RADIUS, THICK, TAIL = 10.0, 0.1, 4.0
BELT_SIDE, DRUM_SIDE, SHAFT, ENDS = 1, 2, 3, 4
MU, PULL = 0.3, 2.0
BELT, DRUM = 80, 71  # facets around the belt's half of the drum, and around a little more


def strip(layers):
    """Return nodes and quadrilaterals of layers (l, n, 2) of nodes, outwards and anticlockwise."""
    _, cells = grid(layers.shape[1] - 1, len(layers) - 1, lambda s, t: (s, t))
    return layers.reshape(-1, 2), cells[:, [0, 2, 1, 3]]


def directions(angles):
    """Return the directions (n, 2) from the centre."""
    return np.column_stack([np.cos(angles), np.sin(angles)])


def bodies():
    """Return the belt with two straight ends, and the drum, a little more than its upper half."""
    hanging = TAIL / RADIUS * np.arange(1, 11) / 10
    angles = np.concatenate([-hanging[::-1], np.linspace(0, np.pi, BELT + 1), np.pi + hanging])
    inside = np.clip(angles, 0.0, np.pi)
    below = RADIUS * np.abs(angles - inside)[:, None] * [0.0, 1.0]
    belt = [r * directions(inside) - below for r in RADIUS + THICK * np.array([0, 0.5, 1])]
    way = directions(np.linspace(-0.3, np.pi + 0.3, DRUM + 1))
    drum = [r * way for r in np.linspace(0.6 * RADIUS, RADIUS, 5)]
    return strip(np.array(belt)), strip(np.array(drum))


def side(body, x):
    """Return the tag of a facet of the belt (1) or the drum (2) by its middle."""
    r = np.hypot(x[:, 0], x[:, 1])
    inner = np.where(x[:, 1] > 0, r, abs(x[:, 0])) < RADIUS + 0.25 * THICK
    end = x[:, 1] < 1e-9 - TAIL
    belt = np.select([end, inner], [ENDS, BELT_SIDE], 0)
    drum = np.select([r < 0.61 * RADIUS, r > 0.99 * RADIUS], [SHAFT, DRUM_SIDE], 0)
    return np.where(body == 1, belt, drum)


@pytest.mark.serial
@pytest.mark.parametrize("slave", quick([DRUM_SIDE, BELT_SIDE], BELT_SIDE))
def test_a_belt_on_a_drum(slave):
    """It slips to both sides, and its pressure falls towards the top as Euler's; without cuts."""
    made = Bodies.of(bodies(), side)
    domain, cells, facets = made.mesh, made.cells, made.facets
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    traction = fem.Constant(domain, np.zeros(2))
    ds = ufl.Measure("ds", domain, subdomain_data=facets)
    master = BELT_SIDE + DRUM_SIDE - slave
    contact = dm.Contact(facets, slave=slave, master=master, friction=MU)
    bcs = [held(V, facets, ENDS, 0.0, 0), held(V, facets, SHAFT)]
    laws = {1: dm.Elastic(20e3, 0.0), 2: dm.Elastic(200e3, 0.3)}
    loads = ufl.inner(traction, ufl.TestFunction(V)) * ds(ENDS)
    problem = create_problem(V, [contact], bcs, laws, cells, loads=loads)

    def on_time(time):
        traction.value[1] = -time * PULL / THICK

    for step in dm.load_steps(problem, [0.5, 1.0], on_time=on_time, progress=False):
        assert len(step.parts) == 1
    nodes = contact.gather(problem.u)
    x, y = nodes["X"].T[:2]
    sign = 1.0 if slave == BELT_SIDE else -1.0
    assert sign * contact.force == pytest.approx([0.0, 2 * PULL], abs=2e-3 * PULL)
    wrapped = (nodes["status"] > 0) & (y > 0.3 * RADIUS)
    assert (nodes["status"][wrapped] == 2.0).sum() >= wrapped.sum() - 1
    angle = np.arctan2(y, np.abs(x))[wrapped]
    euler = PULL / RADIUS * np.exp(-MU * angle)
    off = np.abs(nodes["pressure"][wrapped] / euler - 1.0)
    assert off.max() < 0.08 and np.median(off) < 0.02
