# SPDX-License-Identifier: MIT
"""Newton on random cases: depth, radius, materials, element sizes, slave side, gap or overlap."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.hertz_case import create_case

CASES = 200


def draw(seed):
    """Return the data of a random case."""
    rng = np.random.default_rng(seed)
    radius = float(rng.uniform(4.0, 16.0))
    h = tuple(float(v) for v in rng.uniform(0.15, 0.6, 2))
    gap = float(rng.choice([0.0, rng.uniform(0.0, 0.1), -rng.uniform(0.0, 0.1)]))
    depth = max(gap, 0.0) + float(10 ** rng.uniform(-2.5, -0.3)) * radius / 8.0
    laws = {}
    for tag in (dm.meshing.BLOCK, dm.meshing.DISC):
        E, nu = 10 ** rng.uniform(4.5, 5.6), rng.uniform(0.0, 0.45)
        limit, modulus = rng.uniform(150.0, 1200.0), 10 ** rng.uniform(2.5, 4.5)
        plastic = rng.uniform() < 0.8
        laws[tag] = (
            dm.VonMises.from_uniaxial(E, nu, limit, modulus) if plastic else dm.Elastic(E, nu)
        )
    return {
        "mesh": {
            "kind": str(rng.choice(["paper", "graded"])),
            "h": h,
            "radius": radius,
            "gap": gap,
            "cell": str(rng.choice(["triangle", "quadrilateral"])),
        },
        "laws": laws,
        "slave": str(rng.choice(["block", "disc"])),
        "geometry": str(rng.choice(["reference", "updated"])),
        "depth": depth,
    }


def run(seed):
    """Solve one random case in one step; return the report."""
    data = draw(seed)
    mesh = dm.meshing.hertz(MPI.COMM_WORLD, **data["mesh"])
    case = create_case(mesh, data["laws"], slave=data["slave"], geometry=data["geometry"])
    case.press(data["depth"])
    report = dm.newton(case.problem)
    assert case.force > 0
    assert report.certificate.gap < 1e-6
    return report


@pytest.mark.parametrize("seed", range(3))
def test_some_random_cases(seed):
    """A few cases in every run."""
    assert run(seed).converged


@pytest.mark.slow
def test_random_cases():
    """No case fails."""
    failures = {}
    for seed in range(CASES):
        try:
            run(seed)
        except Exception as error:
            failures[seed] = f"{draw(seed)}: {error}"
    assert not failures, "\n".join(f"{k}: {v}" for k, v in failures.items())
