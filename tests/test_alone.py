# SPDX-License-Identifier: MIT
"""Workers of pytest-xdist wait while a run on ranks has the machine, and it waits for them."""

import fcntl
import os
from pathlib import Path
from threading import Event, Thread

import pytest

from tests import alone
from tests.alone import Machine

pytestmark = pytest.mark.serial
WHILE = 0.05  # seconds in which a thread that may go on does so


def test_who_is_alone_waits_for_others_and_they_for_it(tmp_path):
    """Tests that begin while somebody waits to be alone do not come first."""
    ranks, worker, late = (Machine(tmp_path) for _ in range(3))
    order = []
    in_test, may_end, had_it, came_late = (Event() for _ in range(4))

    def test():
        with worker.shared():
            in_test.set()
            may_end.wait()

    def job():
        with ranks.shared(), ranks.alone():
            order.append(ranks)
            came_late.wait(WHILE)
            order.append(ranks)
            had_it.set()

    def next_test():
        with late.shared():
            order.append(late)
            came_late.set()

    threads = [Thread(target=target, daemon=True) for target in (test, job, next_test)]
    threads[0].start()
    in_test.wait()
    for thread, done in zip(threads[1:], (had_it, came_late), strict=True):
        thread.start()
        assert not done.wait(WHILE)
    may_end.set()
    for thread in threads:
        thread.join()
    assert order == [ranks, ranks, late]


def test_workers_share_the_machine_during_each_test():
    """A run of one process has no locks."""
    machine = alone._machine()
    assert (machine is None) == (alone.WORKER not in os.environ)
    if machine is not None:
        other = Machine(Path(os.environ[alone.FOLDER]))
        with pytest.raises(BlockingIOError):
            fcntl.flock(other.machine, fcntl.LOCK_EX | fcntl.LOCK_NB)
