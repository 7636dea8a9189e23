# SPDX-License-Identifier: MIT
"""The data of random problems. The order of the draws is frozen, so that seeds keep theirs."""

from typing import Any

import numpy as np

import dolfinx_mortar as dm

Draw = dict[str, Any]
GEOMETRIES = ["updated", "reference"]


def draw(kind, seed):
    """Return the data of a random problem."""
    number, make = KINDS[kind]
    return make(np.random.default_rng([seed, number]))


def _choice(rng, *values):
    return float(rng.choice(values))


def _laws(rng, tags):
    """Draw moduli over two and a half decades, also auxetic; six of ten laws are plastic."""
    laws = {}
    for tag in tags:
        E, nu = float(10 ** rng.uniform(3.0, 5.7)), float(rng.uniform(-0.2, 0.49))
        if rng.uniform() < 0.6:
            limit = float(E * 10 ** rng.uniform(-3.2, -1.8))
            modulus = _choice(rng, 0.0, E * 10 ** rng.uniform(-3, -0.5))
            laws[tag] = dm.VonMises.from_uniaxial(E, nu, limit, modulus)
        else:
            laws[tag] = dm.Elastic(E, nu)
    return laws


def _hertz(rng):
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


def _boxes3(rng):
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


def _ring(rng):
    """Draw the half sections of a half ball and a round plate."""
    data = _hertz(rng)
    mesh = data["mesh"] | {"half": True}
    return data | {"mesh": mesh, "tilt": 0.0, "kinematics": "axisymmetric"}


def _second(rng):
    """Draw discs on blocks, or balls on plates, of second order on coarser meshes."""
    data = _ring(rng) if rng.uniform() < 0.3 else _hertz(rng)
    mesh = data["mesh"] | {"h": tuple(min(1.5 * h, 0.9) for h in data["mesh"]["h"])}
    return data | {"mesh": mesh, "degree": 2}


def _second3(rng):
    """Draw two boxes of second order."""
    data = _boxes3(rng)
    mesh = data["mesh"]
    coarse = {name: tuple(min(n, 3) for n in mesh[name]) for name in ("n_lower", "n_upper")}
    return data | {"mesh": mesh | coarse, "degree": 2}


def _friction(rng):
    """Draw bodies of all shapes and cells that are pressed, pushed aside and pushed back."""
    base = (_hertz, _boxes3, _ring, _second, _second3)[int(rng.choice(5, p=_SHAPES))]
    data = base(rng)
    name = str(rng.choice(["friction", "friction", "friction", "tresca"]))
    value = _choice(rng, rng.uniform(0.0, 0.3), rng.uniform(0.0, 1.0), 1.0)
    if name == "tresca":
        softest = min(getattr(law, "E", None) or law.E1 for law in data["laws"].values())
        value *= float(softest * 10 ** rng.uniform(-4.0, -1.0))
    given = str(rng.choice(["number", "constant", "function"]))
    presses, pushes, returns = (int(rng.integers(1, n)) for n in (3, 4, 4))
    far = data["depth"] * float(rng.uniform(0.1, 1.0))
    eases = float(rng.choice([1.0, 1.0, rng.uniform(0.2, 1.0)]))
    path = [(0.0, 0.0, k / presses) for k in range(1, presses + 1)]
    turn = float(rng.uniform(-np.pi, np.pi))
    there = far * np.array([np.cos(turn), np.sin(turn)])
    aside = far * rng.uniform(-0.3, 0.3, 2)
    ring = data.get("kinematics") == "axisymmetric"  # cannot be pushed aside, so it is let off
    for k in range(1, pushes + 1):
        path.append((*(there * k / pushes), 1.0 - 0.5 * ring * k / pushes))
    for k in range(1, returns + 1):
        share = k / returns
        depth = 0.5 * (1.0 + share) if ring else 1.0 + share * (eases - 1.0)
        path.append((*((1.0 - 2.0 * share) * there + share * aside), depth))
    law = {"name": name, "value": value, "given": given}
    # limits that act on open sides, too, want sides that stay where they are
    geometry = "reference" if name == "tresca" else data["geometry"]
    walk = {"path": path, "steps": len(path), "tilt": 0.0}
    return data | {"law": law, "geometry": geometry} | walk


def _finite(rng):
    """Draw bodies of all shapes and cells at finite strain, pressed far and perhaps dragged."""
    base = (_hertz, _boxes3, _ring, _second, _second3)[int(rng.choice(5, p=_SHAPES_OF_FINITE))]
    data = base(rng) | {"geometry": "updated", "strain": "finite"}
    ring, d = "kinematics" in data, 3 if "jitter" in data["mesh"] else 2
    size = data["mesh"].get("radius", 1.0)
    depth = max(data["mesh"]["gap"], 0.0) + float(size * 10 ** rng.uniform(-2.0, -0.7))
    presses, drags = int(rng.integers(1, 5)), int(rng.integers(0, 5))
    way = 0.0 if ring else float(size * rng.uniform(-0.5, 0.5))
    path = [(0.0, 0.0, k / presses) for k in range(1, presses + 1)]
    path += [(way * k / drags, 0.3 * way * k / drags, 1.0) for k in range(1, drags + 1)]
    laws = {tag: _law_of_finite(rng) for tag in (1, 2)}
    cell, degree = data["mesh"]["cell"], data.get("degree", 1)
    splits = all(getattr(law, "volumetric", None) or law.splits for law in laws.values())
    quads = cell in ("quadrilateral", "hexahedron")
    reduced = splits and (quads or degree == 2) and rng.uniform() < 0.5
    turn = float(rng.uniform(-0.5, 0.5)) if d == 2 and not ring else 0.0
    step = {"depth": depth, "path": path, "steps": len(path), "tilt": 0.0, "turn": turn}
    return data | step | {"laws": laws, "volumetric": "reduced" if reduced else "full"}


def _law_of_finite(rng):
    E, nu = float(10 ** rng.uniform(0.0, 3.0)), float(rng.uniform(-0.2, 0.49))
    Y, a, H = (float(E * 10 ** rng.uniform(*ends)) for ends in _EXPONENTS_OF_FINITE)
    mu, bulk = E / 3, float(E * 10 ** rng.uniform(0.0, 3.0))
    kind = str(rng.choice(["neo", "neo", "mooney", "ogden", "elastic", "mises", "mixed"]))
    if kind == "neo":
        return dm.NeoHooke(E, nu)
    if kind == "mooney":
        share = float(rng.uniform(0.0, 1.0))
        return dm.MooneyRivlin(share * mu / 2, (1 - share) * mu / 2, bulk)
    if kind == "ogden":
        return dm.Ogden((mu, -mu / 5), (1.5, -2.0), bulk)
    if kind == "elastic":
        return dm.Elastic(E, nu)
    return dm.VonMises(E, nu, Y, a if kind == "mixed" else 0.0, H)


_SHAPES_OF_FINITE = (0.4, 0.2, 0.2, 0.12, 0.08)
_EXPONENTS_OF_FINITE = ((-2.5, -1.3), (-2.0, -0.5), (-2.0, -0.5))
_SHAPES = (0.4, 0.3, 0.1, 0.12, 0.08)
KINDS = {  # with a number that is part of the seed
    "hertz": (0, _hertz),
    "boxes3": (3, _boxes3),
    "ring": (5, _ring),
    "second": (6, _second),
    "second3": (7, _second3),
    "friction": (9, _friction),
    "finite": (10, _finite),
}
