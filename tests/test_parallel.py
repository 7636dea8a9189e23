# SPDX-License-Identifier: MIT
"""The tests again, on more ranks.

Those marked `mpi` once for each change: quick files by the default run, the others by the slow one.
At night all quick tests on two and on three ranks, and slow ones on one of these numbers.
"""

import os

from mpi4py import MPI

import pytest

from tests import jobs

COMM = MPI.COMM_WORLD
RANKS = "DOLFINX_MORTAR_TEST_RANKS"
# Each file has one number of ranks. On three, where a rank may be in the middle and own nothing:
# all that is not named here, which is what pairs, sends, and solves. On two: what does to a rank
# the same for any number. The slow run has what stands on that, or pairs in space. The others know
# little of ranks, as laws and meshes, or solve many problems: at night.
ON_TWO = """
    agreement errors friction_errors inp mesh_audit msh problem
    point_terms progress results summary tags terms
""".split()
SLOW_ON_THREE = """
    contracts/interfaces driven_tools exact_tangent finite_sliding friction_laws friction_path
    heat load_steps offset pairs patch rigid_side same_sums slaves_on_rollers tangent wear
""".split()
AT_NIGHT = """
    audit axisymmetric_contact axisymmetric_patch bending certificate checkpoint
    checkpoint_damage checkpoint_errors checkpoint_whole corners creep crossings curvature_jumps
    demo_meshes dynamics edges eigenstrain energies faceted_shapes finite_loads
    impact jump jump_errors kinematics linear linearisation margin
    measure near newton obstacle output output_resume own_interface parameters passing
    plane_stress plotting plotting_space pointwise pretension qp_definite ramp reaction
    resolution rubber sensitivity small_strain smooth_3d smooth_contact smooth_tie solid
    stack sweep taylor_bar tie_reach tool_files tool_friction turned_ties tying undone
    user_laws volumetric
""".split()
QUICK = "mpi and not slow and not serial"
SLOW = "mpi and slow and not nightly and not serial"


def run_on_ranks(ranks, selection, seconds, files):
    command = ["-m", "pytest", *sorted(files), "-p", "no:cacheprovider", "-x", "-q"]
    variables = {RANKS: str(ranks), "PYTEST_ADDOPTS": ""}
    where = {"cwd": jobs.ROOT, "seconds": seconds, "variables": variables}
    done = jobs.run(ranks, *command, "-m", selection, **where)
    if done.returncode != 0:
        last = "\n".join((done.stdout + done.stderr).splitlines()[-80:])
        pytest.fail(f"{' '.join(done.args)}\nexit code {done.returncode}\n{last}", pytrace=False)


@pytest.mark.mpi
def test_ranks_form_one_job():
    assert COMM.size == int(os.environ.get(RANKS, COMM.size))
    assert COMM.allreduce(1) == COMM.size


def files_of(names):
    """Return the paths of test files."""
    places = (name.rpartition("/") for name in names)
    return {f"tests/{folder}{slash}test_{name}.py" for folder, slash, name in places}


def other_files():
    """Return the test files that no list names; those of the lists have tests for ranks."""
    named = files_of([*ON_TWO, *SLOW_ON_THREE, *AT_NIGHT])
    paths = jobs.ROOT.glob("tests/**/test_*.py")
    marked = {str(p.relative_to(jobs.ROOT)) for p in paths if "mark.mpi" in p.read_text()}
    assert named <= marked and len(named) == len(ON_TWO) + len(SLOW_ON_THREE) + len(AT_NIGHT)
    return marked - named


@pytest.mark.serial
def test_quick_files_on_two_ranks():
    run_on_ranks(2, QUICK, 900.0, files_of(ON_TWO))


@pytest.mark.serial
def test_quick_files_on_three_ranks():
    run_on_ranks(3, QUICK, 900.0, other_files())


@pytest.mark.serial
@pytest.mark.slow
def test_other_files_on_three_ranks():
    run_on_ranks(3, QUICK, 1800.0, files_of(SLOW_ON_THREE))


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("ranks", [2, 3])
def test_all_tests_on_ranks(ranks):
    run_on_ranks(ranks, "not slow and not serial", 3600.0, ["tests"])


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("ranks", [2, 3])
def test_slow_tests_on_ranks(ranks):
    on_three = files_of(SLOW_ON_THREE) | other_files()
    run_on_ranks(ranks, SLOW, 7200.0, on_three if ranks == 3 else files_of([*ON_TWO, *AT_NIGHT]))
