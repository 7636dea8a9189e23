# SPDX-License-Identifier: MIT
"""Programs that tests start, on one rank or on several."""

import os
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE, CompletedProcess

from tests.alone import alone

ROOT = Path(__file__).resolve().parent.parent
# what a launcher tells its ranks, and pytest its workers: a second one below would take itself for
# one of them
LAUNCHER = ("OMPI_COMM_", "OMPI_APP_", "OMPI_FIRST_", "PMIX_", "PRTE_JOB", "PRTE_LAUNCHED", "PMI_")
LAUNCHER += ("PYTEST_XDIST_",)


def run(
    ranks,
    *arguments,
    cwd=None,
    seconds=None,
    variables=None,
):
    """Run Python with these arguments; on several ranks, without other tests beside it.

    The checkout is on its path. A run that takes longer than `seconds` is ended and has failed.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), environment.get("PYTHONPATH", "")])
    environment |= variables or {}
    launcher = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    command = [*launcher, sys.executable, *map(str, arguments)]
    if ranks == 1:
        return _ended(command, environment, cwd, seconds)
    with alone():
        return _ended(command, environment, cwd, seconds)


def _ended(command, environment, cwd, seconds):
    """Run a command to its end, or end it after some seconds."""
    with subprocess.Popen(
        command, cwd=cwd, env=environment, stdout=PIPE, stderr=PIPE, text=True
    ) as job:
        try:
            said, errors = job.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            job.terminate()  # the launcher takes its ranks along; a kill would leave them behind
            said, errors = job.communicate()
            errors += f"\nended after {seconds} s"
    return CompletedProcess(command, job.returncode, said, errors)
