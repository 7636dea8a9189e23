# SPDX-License-Identifier: MIT
"""Space on the disk is asked for without a trace; files and spaces are what they should be."""

import resource

import pytest

from dolfinx_mortar.common.disk import CHECKPOINT, demand_space, is_checkpoint

pytestmark = pytest.mark.serial


def test_asking_for_space_leaves_the_file_alone(tmp_path):
    file = tmp_path / "out.h5"
    file.write_bytes(b"numbers")
    demand_space(file, 10**6)
    assert file.read_bytes() == b"numbers"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10**5, limits[1]))
    try:
        with pytest.raises(OSError, match=r"no space for 1000000 bytes more: .*out\.h5"):
            demand_space(file, 10**6)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_bytes() == b"numbers"


def test_file_systems_that_cannot_tell(tmp_path, monkeypatch):
    """Nothing is refused there: EOPNOTSUPP."""

    def fail(*_):
        raise OSError(95, "not here")

    monkeypatch.setattr("dolfinx_mortar.common.disk.os.posix_fallocate", fail)
    file = tmp_path / "out.h5"
    file.touch()
    demand_space(file, 10**6)


def test_a_folder_and_no_file_are_no_checkpoints(tmp_path):
    """Asked of every path that a run may write to: neither is an error."""
    assert not is_checkpoint(tmp_path)
    assert not is_checkpoint(tmp_path / "nothing")
    file = tmp_path / "state"
    file.write_bytes(CHECKPOINT + b" 7\n")
    assert is_checkpoint(file)
