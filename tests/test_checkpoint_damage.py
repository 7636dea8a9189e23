# SPDX-License-Identifier: MIT
"""Checkpoints with a changed bit, truncated or extended: always rejected, without a crash.

HDF5 itself does not survive all of them: nothing is given to it before the checksum is right.
"""

import os
import subprocess

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.persistence import checkpoints
from dolfinx_mortar.persistence.checkpoints import HEAD, read_about, read_tables, write
from tests.cases.pressed_blocks import rejected

COMM = MPI.COMM_WORLD
PLACES = np.random.default_rng(0).uniform(0.0, 1.0, (20, 4))


def share(array, rng):
    """Return this rank's part of an array whose rows are dealt out at random, unevenly."""
    rank = rng.integers(0, COMM.size, len(array)) * rng.integers(0, 2, len(array))
    return array[rank == COMM.rank]


def values_at(places):
    """Return two fields of the places."""
    return {"a": np.sin(places @ np.arange(1.0, 5.0))[:, None], "b/c": places**2}


@pytest.mark.mpi
def test_rows_are_dealt_out_anew(folder, rng):
    """What one distribution writes, any other one reads."""
    file, places = folder / "x.h5", rng.uniform(-1.0, 1.0, (101, 4))
    written, wanted = share(places, rng), share(rng.permutation(places), rng)
    none = np.zeros((0, 4))
    given = {"text": "ä", "numbers": [0.1, np.float64(1 / 3), np.inf]}
    values = {"x": {"places": written} | values_at(written), "none": {"places": none, "a": none}}
    write(COMM, file, given, values)
    about = read_about(COMM, file)
    assert about["text"] == "ä" and about["numbers"] == [0.1, 1 / 3, np.inf]
    found, differ = read_tables(COMM, file, about, {"x": wanted, "none": none}, 1.0)
    assert not differ and found["none"]["a"].shape == (0, 4)
    for name, values in values_at(wanted).items():
        assert np.array_equal(found["x"][name], values)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Return a file with a small table, as all ranks see it, and its bytes."""
    file = COMM.bcast(tmp_path_factory.mktemp("damage") / "good.h5")
    own = PLACES[COMM.rank :: COMM.size]
    write(COMM, file, {"level": 0.5}, {"x": {"places": own, "u": own**2}})
    return file, COMM.bcast(file.read_bytes())


def put(file, content):
    """Write a file on rank 0, for all."""
    COMM.barrier()
    if COMM.rank == 0:
        file.write_bytes(content)
    COMM.barrier()


def flipped(content, bit):
    """Return bytes with another value of one bit."""
    k = bit // 8
    return content[:k] + bytes([content[k] ^ (1 << bit % 8)]) + content[k + 1 :]


def refuse(file, monkeypatch):
    """Expect an error that names the file on all ranks, before HDF5 has seen it."""

    def never(*_):
        raise AssertionError("HDF5 was given a damaged file")

    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "_opened", never)
        with rejected(f"path is {str(file)!r}, "):
            read_about(COMM, file)


@pytest.mark.mpi
def test_no_bit_is_taken_for_another(good, folder, monkeypatch):
    """Bits of the lines in front, and others all over the file; nor another length."""
    _, content = good
    file = folder / "flip.h5"
    rng = np.random.default_rng(1)
    lines = content.index(b"\0")
    bits = [*range(0, 8 * lines, 17), *rng.integers(8 * lines, 8 * len(content), 60)]
    sizes = {0, 1, 40, 127, HEAD - 1, HEAD, len(content) // 2, len(content) - 1}
    others = [flipped(content, int(bit)) for bit in bits] + [content[:size] for size in sizes]
    for other in (*others, content + b"\0", 2 * content):
        put(file, other)
        refuse(file, monkeypatch)
    put(file, content)
    assert read_about(COMM, file)["level"] == 0.5


def test_other_programs_read_it(good):
    """HDF5 finds its data behind our lines, which are text; the checksum is that of sha256sum."""
    file, content = good
    with h5py.File(file) as opened:
        assert opened.userblock_size == HEAD
        found = opened["x/places"][:]
    assert np.array_equal(found[np.lexsort(found.T)], PLACES[np.lexsort(PLACES.T)])
    first, second, rest = content.split(b"\n", 2)
    version = ".".join(dm.__version__.split(".")[:2])
    assert first.decode() == f"dolfinx_mortar checkpoint, format 10, version {version}"
    assert set(rest[:100]) == {0}
    told = subprocess.run(["sha256sum"], input=rest, capture_output=True, check=True).stdout
    assert second == b"sha256 of what follows: " + told.split()[0]


@pytest.mark.mpi
@pytest.mark.parametrize("share", ["one rank", "all ranks"])
def test_a_place_that_is_met_twice(folder, share):
    """Which row belongs to which node is unknown then; as of bodies that lie on each other."""
    file, twice = folder / "x.h5", PLACES.copy()
    twice[4] = twice[3]  # on another rank, if there are several
    x = ", ".join(f"{v:.6g}" for v in PLACES[3, :2])
    for own, there in ((PLACES, twice), (twice, twice), (twice, PLACES)):
        write(COMM, file, {}, {"x": {"places": there[COMM.rank :: COMM.size]}})
        mine = own[COMM.rank :: COMM.size]
        if share == "one rank":
            mine = own if COMM.rank == COMM.size - 1 else own[:0]
        _, differ = read_tables(COMM, file, read_about(COMM, file), {"x": mine}, 1.0)
        if there is twice:
            assert f"or more than once, such as that at ({x})" in differ[0]
        elif share == "one rank" or COMM.size == 1:
            assert differ[0].startswith("x: 1 of 20 are in the checkpoint not at all, or ")
            assert differ[0].endswith(f"such as that at ({x})")


@pytest.mark.serial
def test_the_space_asked_for(tmp_path, monkeypatch):
    """It is enough, and hardly more than the file takes: 8 kB per array, and for the file."""
    asked = []
    monkeypatch.setattr(
        "dolfinx_mortar.common.disk.demand_space", lambda file, size: asked.append(size)
    )
    file, names = tmp_path / "x.h5", [f"table {k}" for k in range(30)]
    values = {f"committed/plastic_strain_{k}": np.ones((13, 2)) for k in range(8)}
    given = dict.fromkeys(names, {"places": np.ones((13, 4))} | values)
    write(MPI.COMM_SELF, file, {"text": "x" * 400_000}, given)
    size = os.path.getsize(file)
    assert size <= asked[0] <= size + 8192 * (30 * (8 + 2) + 3)
