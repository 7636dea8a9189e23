# SPDX-License-Identifier: MIT
"""What every interface satisfies in plastic walks: checkpoints, failed steps, balance, output."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases import friction
from tests.cases.block_piles import COMM
from tests.cases.tightened_bar import clamped
from tests.test_own_interface import Pressed
from tests.tool_case import DISC, STEEL, TOP, Block, Box, R

pytestmark = pytest.mark.mpi
LEVELS = [0.25, 0.5, 0.75, 1.0]
AMOUNTS = dict(zip([0.0, *LEVELS], [0.0, 0.5, 1.0, 0.3, 1.2], strict=True))


def contact():
    """Return a problem, its interface, and what sets the amount of a load."""
    law = dm.VonMises(1000.0, 0.3, 10.0, 100.0)
    case = friction.create(friction=0.3, law=law, geometry="updated")
    return case.problem, case.contact, lambda a: case.push(0.02 * a, -0.02)


def tie():
    case, problem = clamped(law=dm.VonMises(1000.0, 0.3, 2.0, 10.0))
    case.tie.pretension = force = fem.Constant(case.mesh, 0.0)
    return problem, case.tie, lambda a: force.value.fill(12.0 * a)


def obstacle():
    case = Block(n=12, fine=0.6)
    tool = case.tool(DISC, friction=0.3)
    problem = case.problem([tool], law=STEEL)

    def go(a):
        tool.position.value[1] = R - 0.06 * a

    return problem, tool, go


def driven_obstacle():
    case = Block(n=16, fine=0.6)
    load = fem.Constant(case.mesh, 0.0)
    tool = case.tool(DISC, load={"y": load})
    return case.problem([tool], law=STEEL), tool, lambda a: load.value.fill(-1.5 * a - 0.2)


def rigid_side():
    bar = Box("quadrilateral", (8, 2), (0.0, -0.5), (4.0, 0.5), axis=0, degree=2)
    moment = fem.Constant(bar.mesh, 0.0)
    load = {"x": 0.0, "y": 0.0, "moment": moment}
    side = dm.RigidSide(bar.facets, TOP, reference=(4.0, 0.0), load=load)
    problem = bar.problem([side], law=dm.VonMises(1000.0, 0.3, 5.0, 50.0))
    return problem, side, lambda a: moment.value.fill(1.3 * a)


def own():
    case = Pressed(law=dm.VonMises(1000.0, 0.3, 4.0, 100.0))
    return case.problem(), case.plane, lambda a: case.press(0.01 * a)


KINDS = pytest.mark.parametrize(
    "create", [contact, tie, obstacle, driven_obstacle, rigid_side, own]
)


def walk(made, levels):
    """Solve and commit; return forces, motions and displacements of the steps."""
    problem, _, go = made
    steps = dm.load_steps(problem, levels, on_time=lambda t: go(AMOUNTS[t]), progress=False)
    return np.array([shown(made) for _ in steps])


def shown(made):
    """Return what a state has; of ranks in the order of size, as meshes are not divided alike."""
    problem, interface, _ = made
    state = [np.ravel(value) for value in interface.state(False).values()]
    return np.concatenate([interface.force, *state, *map(everywhere, fields_of(problem))])


def fields_of(problem):
    return [problem.u, *problem.solid.state.values()]


def everywhere(f):
    dofs = f.function_space.dofmap
    own = f.x.array[: dofs.index_map.size_local * dofs.index_map_bs]
    return own if COMM.size == 1 else np.sort(np.concatenate(COMM.allgather(own)))


def agree(found, expected):
    size = COMM.allreduce(np.abs(expected).max(initial=0.0), op=MPI.MAX)
    assert np.abs(found - expected).max(initial=0.0) < 1e-6 * size
    assert size > 0.0


@KINDS
def test_a_walk_goes_on_from_a_checkpoint(create, folder):
    path, first, fresh = folder / "state.h5", create(), create()
    whole = walk(create(), LEVELS)
    walk(first, LEVELS[:2])
    first[0].save(path)
    fresh[0].restore(path)
    assert shown(fresh) == pytest.approx(shown(first), rel=1e-12, abs=1e-14)
    agree(walk(fresh, LEVELS[2:]), whole[2:])


@KINDS
def test_a_failed_step_leaves_all_as_it_was(create):
    """The first one, and a later one."""
    made, other = create(), create()
    problem, _, go = made
    for level in LEVELS[:2]:
        before = problem.committed.begun and shown(made)
        go(AMOUNTS[0.5])
        with pytest.raises(dm.NewtonNotConverged):
            dm.newton(problem, max_it=1, rtol=1e-12)
        go(AMOUNTS[0.25])
        assert not problem.committed.begun or np.array_equal(shown(made), before)
        agree(walk(made, [level]), walk(other, [level]))
    agree(walk(made, LEVELS[2:]), walk(other, LEVELS[2:]))


@KINDS
def test_looks_change_nothing(create):
    """Audits, results, reports, tries that are taken back, edits: to the last bit."""
    looked, plain = create(), create()
    for made in (looked, plain):
        problem, interface, go = made
        for level in LEVELS:
            before = problem.u.x.array.copy()
            if made is looked:
                assert str(problem.audit()) and problem.output_fields()
                go(0.9 * AMOUNTS[level])
                report = dm.newton(problem, rtol=1e-3)
                assert repr(report) and str(report.certificate) and report.as_dict()
                assert dm.reaction(problem).force.any()
                if create is not rigid_side:
                    interface.gather(problem.u)
                problem.u.x.array[:] = before
            go(AMOUNTS[level])
            dm.newton(problem, rtol=1e-9)
            fields = [] if create is rigid_side else interface.nodal.values()
            kept = [(f, f.x.array.copy()) for f in fields if made is looked]
            for f, _ in kept:
                f.x.array[:] = 7.0
            problem.commit()
            for f, values in kept:
                f.x.array[:] = values
    if COMM.size == 1 and create in (contact, obstacle, own):  # others start where they were led
        assert np.array_equal(shown(looked), shown(plain))
    agree(shown(looked), shown(plain))


@KINDS
def test_forces_are_in_balance(create):
    """With those of the other side, or of the supports."""
    problem, interface, _ = made = create()
    walk(made, LEVELS[:2])
    if hasattr(interface, "master_force"):
        assert interface.master_force == pytest.approx(-interface.force, abs=1e-9)
    if create in (obstacle, driven_obstacle, rigid_side, own):
        supports = dm.reaction(problem, None).force
        assert supports == pytest.approx(-interface.force, abs=1e-5)


@KINDS
def test_results_are_written(create, folder):
    path, (problem, interface, _) = folder / "steps.xdmf", (made := create())
    walk(made, LEVELS[:1])
    if create is not rigid_side:
        closed, fields = interface.active.x.array > 0.0, problem.output_fields()
        pressure = fields["pressure"].x.array[closed]
        assert pressure == pytest.approx(interface.pressure.x.array[closed])
    with dm.Writer(path, problem) as writer:
        writer.write(1.0)
    assert path.exists()
    assert type(interface).__name__ in str(problem.audit())
