# SPDX-License-Identifier: MIT
"""Large sliding at finite strain in 2D: Newton's iterations, and forces of an independent program.

That program (2D, JAX; plane strain, neo-Hooke, four-node cells, the same mortar method between
facets) has solved the same meshes; its forces and numbers of iterations are quoted.
"""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.interfaces import contact as interface
from dolfinx_mortar.problem import predictors
from tests.cases.finite_sliding import COMM, averaged, indentation, walk
from tests.cases.hertz import create_case


def iterations(steps):
    """Return the Newton iterations of each step."""
    return np.array([report.newton_iterations for _, _, report in steps])


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("modulus", "slave", "force", "swapped", "most"),
    [
        (10.0, "tool", 0.388957, 0.393826, 20),
        pytest.param(10.0, "block", 0.393826, 0.388957, 21, marks=pytest.mark.slow),
        pytest.param(1.0, "tool", 0.285278, 0.282147, 20, marks=pytest.mark.slow),
        pytest.param(1.0, "block", 0.282147, 0.285278, 21, marks=pytest.mark.slow),
    ],
)
def test_half_ring_pressed_to_a_strain_of_20_percent(
    modulus, slave, force, swapped, most, monkeypatch
):
    """Force to 2e-6 of the independent program, in four steps of five iterations."""
    sizes = {"radius": 1.0, "length": 6.0, "height": 2.0}
    both = interface.common_normals
    for error, normals in (
        (0.2 * abs(force - swapped), both),
        (2e-6 * force + 5e-7, averaged),
    ):
        monkeypatch.setattr(interface, "common_normals", normals)
        case = indentation(n=((24, 5), (16, 2)), moduli=(1.0, modulus), slave=slave, **sizes)
        steps = walk(case, lambda t: (0.0, -0.4 * t), np.arange(1, 5) / 4, rtol=1e-10)
        assert abs(np.abs(steps[-1][1][1]) - force) < error
        assert iterations(steps).sum() <= most
        for _, _, report in steps:
            assert report.iterations[-1].exact_tangent


@pytest.mark.mpi
def test_moments_of_both_sides_agree_to_the_second_order():
    """The same at 1e-11, a quarter at half the size."""
    found = []
    for k, rtol in ((1, 1e-6), (1, 1e-11), (2, 1e-6)):
        sizes = {"radius": 1.0, "length": 6.0, "height": 2.0}
        case = indentation(n=((24 * k, 5 * k), (16 * k, 2 * k)), **sizes)
        *_, (_, _, report) = walk(case, lambda t: (0.1 * t, -0.2), [0.0, 1.0, 2.0], rtol=rtol)
        assert report.certificate.internal_moment < 1e-14
        found.append(report.certificate.moment_balance)
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    assert found[0] < 5e-4 and found[2] < 0.35 * found[0]


def ironed(drag, **options):
    """Press a half ring into a block in 10 steps and drag it by two diameters; return the steps."""
    case = indentation(n=((48, 10), (32, 4)), **options)

    def path(t):
        return 6.0 * max(t - 1.0, 0.0), -0.75 * min(t, 1.0)

    times = [*np.arange(1, 11) / 10, *(1 + np.arange(1, drag + 1) / drag)]
    steps = walk(case, path, times, rtol=1e-8)
    assert len(steps) == len(times)  # no step was cut
    return steps


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slave", "force"), [("tool", (0.007346, 0.638620)), ("block", (0.006054, 0.638062))]
)
def test_ironing_ends_with_the_forces_of_the_independent_program(slave, force, monkeypatch):
    """To 2e-6, with its normals; that one takes 149 and 161 iterations."""
    monkeypatch.setattr(interface, "common_normals", averaged)
    steps = ironed(20, slave=slave, friction=0.0)
    assert np.abs(np.abs(steps[-1][1]) - force).max() < 2e-6


@pytest.mark.mpi
@pytest.mark.parametrize("slave", ["tool", "block"])
def test_the_force_on_a_flat_side_is_normal_to_it(slave):
    """A half ring is pressed between two nodes of a flat block; facet normals give T/N = .013."""
    sizes = {"radius": 1.0, "length": 6.0, "height": 2.0, "start": 3.05}
    case = indentation(n=((24, 6), (16, 2)), slave=slave, friction=0.0, **sizes)
    (*_, force, _) = walk(case, lambda t: (0.0, -0.2 * t), [0.5, 1.0])[-1]
    assert abs(force[0]) < 2e-4 * abs(force[1])


def slider(depth, **options):
    """Press a half ring on the first of some blocks, and drag it along; forces and reports."""
    sizes = {"radius": 0.5, "length": 2.0, "height": 1.0, "start": 1.67, "moduli": (1.0, 1.0)}
    case = indentation(n=((12, 6), (16, 3)), friction=0.3, **sizes, **options)
    times = [0.5, 1.0, *(1 + np.arange(1, 12) / 11)]

    def follow(t):
        case.held.value[:] = 1.21 * max(t - 1.0, 0.0), -depth * min(t, 1.0)

    steps = dm.load_steps(case.problem, times, on_time=follow, rtol=1e-8)
    return [(np.sum(step.forces, axis=0), step.report) for step in steps]


@pytest.mark.mpi
def test_over_a_gap_with_a_contact_for_each_block():
    """Where nodes of one contact depend on those of the other; the same forces behind the gap."""
    runs = [slider(0.1, blocks=(0.0, 2.15), apart=apart) for apart in (False, True)]
    (one, _), (each, _) = (steps[-1] for steps in runs)
    assert all(len(steps) == 13 and not any(r.cuts for _, r in steps) for steps in runs)
    assert np.abs(one).max() > 0.01
    assert np.abs(one - each).max() < 1e-6 * np.abs(one).max()


def test_past_the_end_of_a_block_without_a_cut():
    """There one contact opens a gap that closes without it."""
    steps = slider(0.2)
    assert len(steps) == 13 and not any(report.cuts for _, report in steps)
    assert steps[1][0].any() and not steps[-1][0].any()
    assert max(report.newton_iterations for _, report in steps) <= 10


@pytest.mark.mpi
def test_a_step_slides_by_ten_facets_with_friction():
    """The partners of its slips are far from where it ends: still Coulomb's drag, and few steps."""
    case = indentation(n=((24, 4), (12, 2)), friction=0.3)
    path = lambda t: (5.0 * max(t - 1.0, 0.0), -0.3 * min(t, 1.0))  # noqa: E731
    *_, (_, force, report) = walk(case, path, [0.5, 1.0, 2.0], rtol=1e-8)
    H, V = np.abs(force)
    assert abs(H - 0.3 * V) < 0.02 * V
    assert report.newton_iterations <= 6
    assert report.iterations[-1].exact_tangent


@pytest.mark.mpi
def test_flanks_of_a_dent_do_not_turn_a_contact():
    """Normals under a disc that is pressed in turn, by 4 degrees in the mean, both ways alike."""
    law = dm.NeoHooke(E=1000.0, nu=0.3)
    case = create_case(dm.meshing.hertz(COMM), law, geometry="reference", strain="finite")
    ramp = {case.top: [(0.0, (0.0, 0.0)), (1.5, (0.0, -1.5))]}
    for step in dm.load_steps(case.problem, [0.5, 1.0, 1.5], ramp=ramp, progress=False):
        assert not any("has turned by" in note for note in step.report.notes)


# -- steps in which a body slides over another one begin with the deformation moved along

PRESSED, DRAGGED = 3, 4
SIZES = {"radius": 1.0, "length": 6.0, "height": 2.0, "start": 2.0}


def slid(slave, *, tool_held=False):
    """Press a half ring .3 deep and drag it, or the block, by facets; return the drag's steps."""
    case = indentation(n=((24, 5), (16, 2)), slave=slave, friction=0.0, **SIZES)
    place = case.base if tool_held else case.held

    def path(t):
        place.value[:] = (-0.6 if tool_held else 0.6) * max(t - PRESSED, 0.0), 0.0
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
