# SPDX-License-Identifier: MIT
"""The tests again, on more ranks.

Those marked `mpi` on two or three by default, all of these on two when slow, and all that have not
one rank only on three at night.
"""

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from mpi4py import MPI

import pytest

COMM = MPI.COMM_WORLD
ROOT = Path(__file__).resolve().parent.parent
# what a launcher tells its ranks, and pytest its workers; a second one below would take itself for
# one of them
LAUNCHER = ("OMPI_COMM_", "OMPI_APP_", "OMPI_FIRST_", "PMIX_", "PRTE_JOB", "PRTE_LAUNCHED", "PMI_")
LAUNCHER += ("PYTEST_XDIST_",)


RANKS = "DOLFINX_MORTAR_TEST_RANKS"
# By default each file has one number of ranks. On three, where a rank may be in the middle and own
# nothing: all that is not named here, which is what pairs, sends, and solves. On two: what does to
# a rank the same for any number. On one: what knows nothing of ranks, as laws and meshes, or stands
# on what has run on three. The slow run has all on two, the nightly one on three.
ON_TWO = """
    agreement arguments audit checkpoint checkpoint_damage checkpoint_errors
    checkpoint_files edges errors failures friction_errors jump jump_errors linear loads
    looks_change_nothing mesh_audit msh newton output output_resume passing plotting preload
    problem progress ramp reaction regions results small_strain smooth_contact solid solid_state
    summary sweep tags terms tie_reach tying written_results
""".split()
ON_ONE = """
    axisymmetric_contact axisymmetric_patch axisymmetry certificate curvature_jumps demo_meshes
    eigenstrain hardening kinematics law_contact linearisation locking margin measure
    orthotropic parameters patch_3d plane_stress pointwise preload_direction preload_several
    qp_descent resolution smooth_3d smooth_second smooth_tie stand_off stress_laws undone user_laws
    volumetric
""".split()


def run_on_ranks(ranks: int, selection: str, seconds: float, files: Iterable[str]) -> None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment.pop("PYTEST_ADDOPTS", None)
    environment[RANKS] = str(ranks)
    tests = [sys.executable, "-m", "pytest", *files, "-p", "no:cacheprovider", "-x", "-q"]
    command = ["mpirun", "-n", str(ranks), *tests, "-m", selection]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, cwd=ROOT, env=environment, text=True, **pipes) as job:
        try:
            output, _ = job.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            job.terminate()  # the launcher takes its ranks along; a kill would leave them behind
            output, _ = job.communicate()
            output += f"\nended after {seconds} s"
    if job.returncode != 0:
        last = "\n".join(output.splitlines()[-80:])
        pytest.fail(f"{' '.join(command)}\nexit code {job.returncode}\n{last}", pytrace=False)


@pytest.mark.mpi
def test_ranks_form_one_job() -> None:
    assert COMM.size == int(os.environ.get(RANKS, COMM.size))
    assert COMM.allreduce(1) == COMM.size


def files_on(ranks: int) -> list[str]:
    """Return the test files that have this number of ranks by default."""
    one, two = ({f"tests/test_{name}.py" for name in names} for names in (ON_ONE, ON_TWO))
    everything = {str(path.relative_to(ROOT)) for path in ROOT.glob("tests/test_*.py")}
    assert one | two < everything
    return sorted(two if ranks == 2 else everything - one - two)


@pytest.mark.serial
@pytest.mark.parametrize("ranks", [2, 3])
def test_quick_tests_on_ranks(ranks: int) -> None:
    run_on_ranks(ranks, "mpi and not slow and not serial", 900.0, files_on(ranks))


@pytest.mark.serial
@pytest.mark.slow
def test_quick_tests_of_all_files_on_two_ranks() -> None:
    run_on_ranks(2, "mpi and not slow and not serial", 1800.0, ["tests"])


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.nightly
def test_all_tests_on_three_ranks() -> None:
    run_on_ranks(3, "not slow and not serial", 3600.0, ["tests"])
