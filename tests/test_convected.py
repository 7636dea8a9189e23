# SPDX-License-Identifier: MIT
"""Steps in which a body slides over another one begin with the deformation moved along."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.problem import predictors
from tests.cases.finite_sliding import indentation, walk
from tests.cases.meshes_3d import rotation
from tests.tool_case import BASE, Box

PRESSED, DRAGGED = 3, 4
DISC = dm.shapes.Cylinder((2.0, 1.0), 1.0)
SIZES = {"radius": 1.0, "length": 6.0, "height": 2.0, "start": 2.0}


def slid(slave="tool", way=0.6, friction=0.0, *, tool_held=False):
    """Press a half ring .3 deep and drag it, or the block, by facets; return the drag's steps."""
    case = indentation(n=((24, 5), (16, 2)), slave=slave, friction=friction, **SIZES)
    place = case.base if tool_held else case.held

    def path(t):
        place.value[:] = (-way if tool_held else way) * max(t - PRESSED, 0.0), 0.0
        case.held.value[1] = -0.1 * min(t, PRESSED)
        return case.held.value.copy()

    steps = walk(case, path, np.arange(1, PRESSED + DRAGGED + 1), rtol=1e-8)
    return steps[PRESSED:]


def count(steps):
    return sum(report.newton_iterations for _, _, report in steps)


@pytest.mark.parametrize(
    "slave",
    [pytest.param("tool", marks=pytest.mark.mpi), pytest.param("block", marks=pytest.mark.slow)],
)
def test_it_saves_iterations_and_changes_no_answer(slave, monkeypatch):
    """Whichever body is moved: that it is the block whose dent moves is found by the overlap."""
    steps, other = slid(slave), slid(slave, tool_held=True)
    monkeypatch.setattr(predictors, "find_slides", lambda *_: [])
    rigid = slid(slave)
    for found in (other, rigid):
        for (_, force, _), (_, same, _) in zip(steps, found, strict=True):
            assert np.abs(same - force).max() < 1e-7 * np.abs(force).max()
    assert abs(count(other) - count(steps)) <= 1
    assert count(steps) + 3 <= count(rigid)


def ironed_by_tool(law, *, friction=0.0, way=0.6, turned=0.0):
    """Drag a rigid cylinder over a turned block; return iterations and the force, turned back."""
    body = Box("quadrilateral", (24, 5), (0.0, -2.0), (6.0, 0.0))
    base, tool = fem.Function(body.V), body.tool(DISC, friction=friction)
    case = body.problem([tool], law, bcs=[body.hold(BASE, value=base)], strain="finite")
    start = tool.rigid.position.value.copy()

    turn = rotation((0, 0, 1), turned)[:2, :2]

    def move(t):
        place = 2.0 + way * max(t - 3.0, 0.0), 1.0 - 0.1 * min(t, 3.0)
        base.interpolate(lambda x: (turn - np.eye(2)) @ x[:2])
        tool.rigid.position.value[:] = start + turn @ place - (2.0, 1.0)

    steps = list(dm.load_steps(case, np.arange(1, 8), on_time=move, rtol=1e-8))
    return sum(step.report.newton_iterations for step in steps[3:]), tool.force @ turn


@pytest.mark.mpi
def test_turned_bodies_slide_like_others():
    """What moves along is the deformation, which has no part in a rotation by 90 degrees."""
    few, force = ironed_by_tool(dm.NeoHooke(1.0, 0.3))
    turned, same = ironed_by_tool(dm.NeoHooke(1.0, 0.3), turned=np.pi / 2)
    assert np.abs(same - force).max() < 1e-7 * np.abs(force).max()
    assert turned <= few + 1


@pytest.mark.parametrize(
    ("law", "friction", "way"),
    [
        (dm.VonMises(E=1.0, nu=0.3, Y=0.02, a=0.1), 0.0, 0.6),
        (dm.NeoHooke(1.0, 0.3), 5.0, 0.3),
        (dm.NeoHooke(1.0, 0.3), 0.0, 0.2),
    ],
    ids=["internal variables", "sticks", "shorter than a facet"],
)
def test_what_stays(law, friction, way, monkeypatch):
    """Plastic strains, material that sticks; and Newton's method is left alone with short ways."""

    def fail(*_):
        raise AssertionError

    monkeypatch.setattr(predictors, "convected", fail)
    ironed_by_tool(law, friction=friction, way=way)
