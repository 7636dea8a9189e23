# SPDX-License-Identifier: MIT
"""The tests again, on more ranks.

Those marked `mpi` once for each change: quick files by the default run, the others by the slow one.
At night, all that have not one rank only run on two and on three.
"""

import os
from collections.abc import Iterable
from pathlib import Path

from mpi4py import MPI

import pytest

from tests import jobs

COMM = MPI.COMM_WORLD
RANKS = "DOLFINX_MORTAR_TEST_RANKS"
# Each file has one number of ranks. On three, where a rank may be in the middle and own nothing:
# all that is not named here, which is what pairs, sends, and solves. On two: what does to a rank
# the same for any number. The slow run has those that know little of ranks, as laws and meshes,
# stand on what has run by default, or solve many problems: on two, and what pairs in space on
# three.
ON_TWO = """
    agreement arguments checkpoint_files errors friction_errors mesh_audit msh problem
    progress regions results summary tags terms written_results
""".split()
SLOW_ON_TWO = """
    audit axisymmetric_contact axisymmetric_patch axisymmetry bending certificate checkpoint
    checkpoint_damage checkpoint_errors curvature_jumps demo_meshes dynamics edges eigenstrain
    energies failures finite_in_space finite_loads finite_plane_stress finite_sliding folds
    heat_in_time jump jump_errors kinematics law_contact linear linearisation loads locking
    logarithmic_solid margin measure newton obstacle orthotropic output output_resume
    parameters passing patch_3d plane_stress plotting pointwise polyline preload
    preload_direction
    preload_several qp_definite qp_descent ramp reaction resolution rubber small_strain smooth_3d
    smooth_contact smooth_second smooth_tie solid solid_state stand_off stress_laws sweep taylor_bar
    tie_reach tool_files tool_friction tool_pictures triangles tying undone user_laws volumetric
""".split()
SLOW_ON_THREE = """
    checkpoint_edits convected corners crossings
    driven_tools exact_tangent exact_tangent_3d friction_path friction_state impact load_steps
    looks_change_nothing mortar_3d near normal_relief numbers_of_steps own_interface pairs patch
    plotting_space preload_restart pretension rigid_side same_sums skins stack swept turned_ties
""".split()
QUICK = "mpi and not slow and not serial"
SLOW = "mpi and not nightly and not serial"


def run_on_ranks(ranks: int, selection: str, seconds: float, files: Iterable[str]) -> None:
    arguments = ["-m", "pytest", *files, "-p", "no:cacheprovider", "-x", "-q", "-m", selection]
    variables = {RANKS: str(ranks), "PYTEST_ADDOPTS": ""}
    done = jobs.run(ranks, *arguments, cwd=jobs.ROOT, seconds=seconds, variables=variables)
    if done.returncode != 0:
        last = "\n".join((done.stdout + done.stderr).splitlines()[-80:])
        command = " ".join(done.args)
        pytest.fail(f"{command}\nexit code {done.returncode}\n{last}", pytrace=False)


@pytest.mark.mpi
def test_ranks_form_one_job() -> None:
    assert COMM.size == int(os.environ.get(RANKS, COMM.size))
    assert COMM.allreduce(1) == COMM.size


def files_on(ranks: int, slow: bool) -> list[str]:
    """Return the test files that have this number of ranks, in the default or in the slow run."""
    named = [ON_TWO, SLOW_ON_TWO, SLOW_ON_THREE]
    on_two, slow_on_two, slow_on_three = ({f"tests/test_{n}.py" for n in names} for names in named)
    paths = [path for path in jobs.ROOT.glob("tests/test_*.py") if "mark.mpi" in path.read_text()]
    rest = {str(p.relative_to(jobs.ROOT)) for p in paths} - on_two - slow_on_two - slow_on_three
    assert len(rest) + sum(map(len, named)) == len(paths)  # each file once
    quick = {2: on_two, 3: rest}
    return sorted({2: slow_on_two, 3: slow_on_three}[ranks] if slow else quick[ranks])


@pytest.mark.serial
@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.parametrize("slow", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_tests_on_ranks(ranks: int, slow: bool) -> None:
    selection, seconds = (SLOW, 1800.0) if slow else (QUICK, 900.0)
    run_on_ranks(ranks, selection, seconds, files_on(ranks, slow))


FAILS_ON_ONE_RANK = """
from mpi4py import MPI

def test_on_one_rank():
    assert MPI.COMM_WORLD.rank != {rank}

def test_of_all_ranks():
    MPI.COMM_WORLD.Barrier()
"""


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize("rank", [0, 1])
def test_what_fails_on_one_rank_ends_the_run_on_all(rank: int, tmp_path: Path) -> None:
    """The others would wait for it in the next test, to the time limit of the run."""
    (tmp_path / "test_it.py").write_text(FAILS_ON_ONE_RANK.format(rank=rank))
    arguments = ["-c", "pyproject.toml", "-p", "tests.conftest", "-x", tmp_path / "test_it.py"]
    done = jobs.run(2, "-m", "pytest", *arguments, cwd=jobs.ROOT, seconds=60.0)
    said = done.stdout + done.stderr
    assert done.returncode != 0
    assert f"[rank {rank}] " in said
    assert "a test failed on a rank" in said
    assert "ended after" not in said


@pytest.mark.serial
@pytest.mark.slow
def test_slow_tests_for_ranks_are_in_files_of_the_slow_run() -> None:
    """The default run takes the quick ones of its files only, so a slow one would be lost."""
    lost = ["--collect-only", "-m", f"{SLOW} and slow", *files_on(2, False), *files_on(3, False)]
    done = jobs.run(1, "-m", "pytest", "-q", *lost, cwd=jobs.ROOT)
    assert done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED, done.stdout


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("ranks", [2, 3])
def test_all_tests_on_ranks(ranks: int) -> None:
    run_on_ranks(ranks, "not slow and not serial", 3600.0, ["tests"])
