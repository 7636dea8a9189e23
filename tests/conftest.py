# SPDX-License-Identifier: MIT
"""Settings of all tests: reproducible random numbers, order and errors on several ranks."""

import gc
import os
import shutil
import tempfile
import time
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import hypothesis
import numpy as np
import pytest

from tests import alone, compiling

COMM = MPI.COMM_WORLD
WAIT = 60.0  # seconds a failed test waits for the other ranks before it ends the whole run
FAILED = pytest.StashKey[bool]()  # of tests that failed on this rank
WORKERS = 4  # at most: each holds the libraries, half a GiB

# Kernels of tests see few cells, so compiling them without optimisation takes a fifth off a cold
# run; a process waits longer than the default 10 s for a kernel that another one is compiling.
# Programs that tests start inherit it.
os.environ["XDG_CONFIG_HOME"] = str(Path(__file__).parent / "config")

compiling.know_what_stays()

# Ranks must draw the same examples, and machines differ in speed.
hypothesis.settings.register_profile("ranks", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("ranks")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Use the cores where whole folders are run; one process where files are named, or on ranks."""
    whole = config.args_source is not pytest.Config.ArgsSource.ARGS
    single = COMM.size == 1 and alone.WORKER not in os.environ
    if whole and single and getattr(config.option, "numprocesses", 0) is None:
        config.option.numprocesses = min(len(os.sched_getaffinity(0)), WORKERS)
        config.option.dist = "worksteal"  # neighbours stay together, and so do their fixtures


@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    """Let only rank 0 write to the terminal; make the locks of the workers, and what all read."""
    if COMM.size == 1 and alone.WORKER not in os.environ:
        headers = tempfile.mkdtemp(prefix="headers-")
        config.add_cleanup(lambda: shutil.rmtree(headers))
        compiling.precompile(Path(headers))
    if getattr(config.option, "numprocesses", None) and alone.WORKER not in os.environ:
        folder = os.environ[alone.FOLDER] = tempfile.mkdtemp(prefix="locks-")
        config.add_cleanup(lambda: shutil.rmtree(folder))
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if COMM.rank > 0 and terminal is not None:
        terminal._tw._file = open(os.devnull, "w")


def pytest_collection_modifyitems(items):
    """Skip what is meant for one rank when there are more; end with the runs on ranks.

    By then the workers have compiled, each on a core of its own, what ranks would wait for.
    """
    items.sort(key=lambda item: item.path.name in ("test_parallel.py", "test_ranks.py"))
    if COMM.size > 1:
        for item in items:
            if "serial" in item.keywords:
                item.add_marker(pytest.mark.skip(reason="for one rank only"))


def pytest_collection_finish():
    """Collect garbage after tests only, at the same time on all ranks, and spare what stays.

    What stays are modules, tests and libraries.
    """
    if COMM.size > 1:
        gc.disable()
        gc.collect()
        gc.freeze()


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol():
    """Let tests that start ranks be alone."""
    with alone.shared():
        yield


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item):
    """Print at once what failed on a silent rank."""
    outcome = yield
    report = outcome.get_result()
    if report.failed and COMM.size > 1:
        item.stash[FAILED] = True
        capture = item.config.pluginmanager.get_plugin("capturemanager")
        with capture.global_and_fixture_disabled():
            text = f"\n[rank {COMM.rank}] {item.nodeid}, {report.when}\n{report.longreprtext}\n"
            os.write(2, text.encode())


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item):
    """Destroy PETSc objects in the same order on all ranks, and end the run if a rank is missing.

    A rank that failed stands here while the others wait in a collective call of the test: without
    the time limit that would last for ever. So would the next test where a failure ends the run on
    some ranks only.
    """
    if COMM.size == 1:
        return
    failed = np.array(item.stash.get(FAILED, False))
    failed_somewhere = np.empty_like(failed)
    arrived = COMM.Iallreduce(failed, failed_somewhere, MPI.LOR)
    start = time.monotonic()
    while not arrived.Test():
        if time.monotonic() - start > WAIT:
            os.write(2, f"[rank {COMM.rank}] the other ranks did not finish\n".encode())
            COMM.Abort(1)
        time.sleep(1e-3)
    if failed_somewhere and item.config.getoption("maxfail"):
        item.session.shouldstop = "a test failed on a rank"
    gc.collect()
    PETSc.garbage_cleanup(COMM)


@pytest.fixture
def rng():
    """Random numbers that are the same on all ranks and in every run."""
    return np.random.default_rng(1)


@pytest.fixture
def folder(tmp_path):
    """Return a folder that all ranks see."""
    return COMM.bcast(tmp_path)
