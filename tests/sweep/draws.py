# SPDX-License-Identifier: MIT
"""The data of random problems. The order of the draws is frozen, so that seeds keep theirs."""

from __future__ import annotations

from typing import Any

import numpy as np

import dolfinx_mortar as dm

Draw = dict[str, Any]
GEOMETRIES = ["updated", "reference"]


def draw(kind: str, seed: int) -> Draw:
    """Return the data of a random problem."""
    return KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))


def _choice(rng: np.random.Generator, *values: float) -> float:
    return float(rng.choice(values))


def _laws(rng: np.random.Generator, tags: range) -> dict[int, dm.Elastic | dm.VonMises]:
    """Draw moduli over two and a half decades, also auxetic; six of ten laws are plastic.

    Half of the plastic ones do not harden.
    """
    laws: dict[int, dm.Elastic | dm.VonMises] = {}
    for tag in tags:
        E, nu = float(10 ** rng.uniform(3.0, 5.7)), float(rng.uniform(-0.2, 0.49))
        if rng.uniform() < 0.6:
            limit = float(E * 10 ** rng.uniform(-3.2, -1.8))
            modulus = _choice(rng, 0.0, E * 10 ** rng.uniform(-3, -0.5))
            laws[tag] = dm.VonMises.from_uniaxial(E, nu, limit, modulus)
        else:
            laws[tag] = dm.Elastic(E, nu)
    return laws


def _hertz(rng: np.random.Generator) -> Draw:
    """Draw a half disc on a block, pressed and perhaps pushed aside."""
    radius = float(rng.uniform(3, 20))
    kind = str(rng.choice(["paper", "graded", "graded", "graded"]))
    gap = _choice(rng, 0.0, rng.uniform(0, 0.1), -rng.uniform(0, 0.2))
    h = tuple(float(v) for v in rng.uniform(0.15, 0.9, 2))
    cell = str(rng.choice(["triangle", "quadrilateral"]))
    block = (float(rng.uniform(1.5, 4) * radius), float(rng.uniform(0.5, 2) * radius))
    depth = max(gap, 0.0) + float(10 ** rng.uniform(-3, np.log10(0.6)))
    steps = int(rng.integers(1, 6))
    slave, geometry = int(rng.choice([3, 4])), str(rng.choice(GEOMETRIES))
    laws = _laws(rng, range(1, 3))
    tilt = _choice(rng, 0, 0, rng.uniform(-0.3, 0.3))
    mesh = {"kind": kind, "h": h, "radius": radius, "gap": gap, "cell": cell, "block": block}
    step = {"depth": depth, "steps": steps, "tilt": tilt}
    return {"mesh": mesh, "slave": slave, "geometry": geometry, "laws": laws} | step


def _sphere(rng: np.random.Generator) -> Draw:
    """Draw a quarter of a half ball on a block."""
    radius = float(rng.uniform(4, 12))
    core = radius * float(rng.uniform(0.1, 0.25))
    h = tuple(float(core / rng.uniform(1.5, 3.5)) for _ in range(2))
    gap = _choice(rng, 0.0, rng.uniform(0, 0.1), -rng.uniform(0, 0.1))
    cell = str(rng.choice(["hexahedron", "tetrahedron"]))
    depth = max(gap, 0.0) + float(10 ** rng.uniform(-3, np.log10(0.6)))
    steps = int(rng.integers(1, 4))
    slave, geometry = int(rng.choice([3, 4])), str(rng.choice(GEOMETRIES))
    laws = _laws(rng, range(1, 3))
    block = (4 * radius, 4 * radius, 1.2 * radius)
    mesh = {"cell": cell, "h": h, "radius": radius, "gap": gap, "core": core, "block": block}
    step = {"depth": depth, "steps": steps}
    return {"mesh": mesh, "slave": slave, "geometry": geometry, "laws": laws} | step


def _pile(rng: np.random.Generator) -> Draw:
    """Draw two to four wavy blocks on each other, under a displacement or a traction."""
    count = int(rng.integers(2, 5))
    right = float(rng.uniform(1, 4))
    boxes, gaps, y = [], [], 0.0
    for k in range(count):
        height = float(rng.uniform(0.4, 1.5))
        narrow = rng.uniform() >= 0.5
        x = (float(rng.uniform(0, 0.3)), right - float(rng.uniform(0, 0.3))) if narrow else None
        gap = _choice(rng, 0, 0, rng.uniform(0, 0.01), -rng.uniform(0, 0.01)) if k else 0.0
        cells = (int(rng.integers(2, 12)), int(rng.integers(1, 6)))
        boxes.append((*(x or (0.0, right)), y + gap, y + gap + height, *cells))
        gaps.append(gap)
        y += gap + height
    cell = str(rng.choice(["triangle", "quadrilateral"]))
    wave = (_choice(rng, 0.0, rng.uniform(-0.2, 0.2)), float(rng.uniform(1, 5)))
    laws = _laws(rng, range(1, count + 1))
    lower_is_slave = [bool(rng.uniform() < 0.5) for _ in range(1, count)]
    load = str(rng.choice(["disp", "traction"]))
    # two blocks may slide: the upper one is then held by the prescribed displacement
    both = load == "disp" and count == 2
    lateral = str(rng.choice(["west", "none"])) if both else "west"
    depth = float(10 ** rng.uniform(-3, np.log10(0.15)))
    steps, geometry = int(rng.integers(1, 6)), str(rng.choice(GEOMETRIES))
    tilt = _choice(rng, 0.0, rng.uniform(-0.3, 0.3))
    shape = {"boxes": boxes, "gaps": gaps, "cell": cell, "wave": wave}
    sides = {"lower_is_slave": lower_is_slave, "load": load, "lateral": lateral}
    step = {"geometry": geometry, "laws": laws, "depth": depth, "steps": steps, "tilt": tilt}
    return shape | sides | step


def _boxes3(rng: np.random.Generator) -> Draw:
    """Draw two boxes with irregular grids and a wavy interface."""
    cell = str(rng.choice(["hexahedron", "tetrahedron"]))
    lower, upper = (tuple(int(v) for v in rng.integers(1, 6, 3)) for _ in range(2))
    ends = (0.0, 1.0, 0.0, 1.0)
    if rng.uniform() < 0.6:
        a, b, c, d = (float(rng.uniform(0, 0.3)) for _ in range(4))
        ends = (a, 1 - b, c, 1 - d)
    gap = _choice(rng, 0.0, rng.uniform(0, 0.01), -rng.uniform(0, 0.01))
    wave = _choice(rng, 0.0, rng.uniform(-0.1, 0.1))
    jitter, grid_seed = float(rng.uniform(0, 0.6)), int(rng.integers(1000))
    laws = _laws(rng, range(1, 3))
    slave, geometry = int(rng.choice([3, 4])), str(rng.choice(GEOMETRIES))
    steps = int(rng.integers(1, 4))
    depth = max(gap, 0.0) + float(10 ** rng.uniform(-3, -1))
    tilt = _choice(rng, 0.0, rng.uniform(-0.3, 0.3))
    mesh = {"n_lower": lower, "n_upper": upper, "upper": ends, "gap": gap, "cell": cell}
    mesh |= {"jitter": jitter, "seed": grid_seed}
    step = {"depth": depth, "steps": steps, "tilt": tilt}
    return {"mesh": mesh, "wave": wave, "slave": slave, "geometry": geometry, "laws": laws} | step


KINDS = {"hertz": _hertz, "sphere": _sphere, "pile": _pile, "boxes3": _boxes3}
