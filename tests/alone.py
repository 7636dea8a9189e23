# SPDX-License-Identifier: MIT
"""Locks that keep other workers of pytest-xdist idle while a test runs a job on ranks.

A rank that waits for a message yields its core. Beside other tests it gets the core back after
their time slice, some milliseconds, and every message takes that long: 330 tests of 100 s on three
ranks had not ended after 600 s. So each worker shares a lock with the others during each of its
tests, and a test that starts ranks holds it alone.
"""

import fcntl
import functools
import os
from contextlib import contextmanager, nullcontext
from pathlib import Path

FOLDER = "DOLFINX_MORTAR_TEST_LOCKS"  # of the locks of a run; its workers inherit the name
WORKER = "PYTEST_XDIST_WORKER"  # set by pytest-xdist


class Machine:
    """Two locks: of the machine, and of the queue, held by who waits for or has it alone."""

    def __init__(self, folder):
        """Open the files of the locks."""
        names = ("queue", "machine")
        self.queue, self.machine = ((folder / name).open("a") for name in names)

    @contextmanager
    def shared(self):
        """Run beside others that share it, when nobody waits to have it alone."""
        with _locked(self.queue, fcntl.LOCK_SH):
            pass
        with _locked(self.machine, fcntl.LOCK_SH):
            yield

    @contextmanager
    def alone(self):
        """Within `shared`: wait for the others to end their tests, and keep them from the next."""
        fcntl.flock(self.machine, fcntl.LOCK_UN)
        with _locked(self.queue, fcntl.LOCK_EX):
            fcntl.flock(self.machine, fcntl.LOCK_EX)
            try:
                yield
            finally:
                fcntl.flock(self.machine, fcntl.LOCK_SH)


@contextmanager
def _locked(file, how):
    """Hold a lock."""
    fcntl.flock(file, how)
    try:
        yield
    finally:
        fcntl.flock(file, fcntl.LOCK_UN)


@functools.cache
def _machine():
    """Return the locks of this worker, none in a run of a single process."""
    both = WORKER in os.environ and FOLDER in os.environ
    return Machine(Path(os.environ[FOLDER])) if both else None


def shared():
    """Hold the machine beside other workers."""
    machine = _machine()
    return machine.shared() if machine else nullcontext()


def alone():
    """Have the machine alone, within a test."""
    machine = _machine()
    return machine.alone() if machine else nullcontext()
