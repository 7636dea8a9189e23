# SPDX-License-Identifier: MIT
"""Space on the disk is asked for without a trace."""

import resource

import pytest

from dolfinx_mortar.disk import demand_space

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


@pytest.mark.parametrize("number", [95, 22, 38])
def test_file_systems_that_cannot_tell(tmp_path, monkeypatch, number):
    """Nothing is refused there: EOPNOTSUPP, EINVAL, ENOSYS."""

    def fail(*_):
        raise OSError(number, "not here")

    monkeypatch.setattr("dolfinx_mortar.disk.os.posix_fallocate", fail)
    file = tmp_path / "out.h5"
    file.touch()
    demand_space(file, 10**6)
