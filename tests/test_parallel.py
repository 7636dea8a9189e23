# SPDX-License-Identifier: MIT
"""The tests again, on more ranks: the quick ones marked `mpi` by default, all of them when slow."""

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from mpi4py import MPI

import pytest

COMM = MPI.COMM_WORLD
ROOT = Path(__file__).resolve().parent.parent
# what a launcher tells its ranks; a second launcher below would take itself for one of them
LAUNCHER = ("OMPI_COMM_", "OMPI_APP_", "OMPI_FIRST_", "PMIX_", "PRTE_JOB", "PRTE_LAUNCHED", "PMI_")


RANKS = "DOLFINX_MORTAR_TEST_RANKS"
# What these do to a rank does not hang on their number: two will do by default, three when slow.
ON_TWO = ("arguments", "loads", "mesh_audit", "output", "smooth_tie", "summary", "user_laws")


def run_on_ranks(ranks: int, selection: str, seconds: float, without: Iterable[str] = ()) -> None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment.pop("PYTEST_ADDOPTS", None)
    environment[RANKS] = str(ranks)
    tests = [sys.executable, "-m", "pytest", "tests", "-p", "no:cacheprovider", "-x", "-q"]
    tests += [f"--ignore=tests/test_{name}.py" for name in without]
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


@pytest.mark.serial
@pytest.mark.parametrize(("ranks", "without"), [(2, ()), (3, ON_TWO)])
def test_quick_tests_on_ranks(ranks: int, without: tuple[str, ...]) -> None:
    assert all((ROOT / "tests" / f"test_{name}.py").exists() for name in without)
    run_on_ranks(ranks, "mpi and not slow and not serial", 600.0, without)


@pytest.mark.serial
@pytest.mark.slow
def test_all_tests_on_ranks() -> None:
    run_on_ranks(3, "not slow and not serial", 1800.0)
